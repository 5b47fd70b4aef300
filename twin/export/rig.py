"""The twin's simulation of one model as a program: which numbers stay parameters, and which are known.

Rule 1: mass, travel, (1), (6), the causes of the model and the law stay parameters.  Causes that it does not have are
        neutral, and T_s is fixed: a controller belongs to one T_s.
Rule 2: what a simulation leaves out (`twin/model/simulate.py`, rule 4) is left out here, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from twin.control import LawNumbers
from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import Cells, Code, Known, Record, Value, name, parameter
from twin.mirror.loop import advance
from twin.model.causes.catalogue import BY_NAME, neutral
from twin.model.causes.cause import Cause, CauseParameter
from twin.model.extended import Base
from twin.model.parameters import Model
from twin.model.simulate import ACT, LINES, SENSE, PlantNumbers, begin, delay_in_ticks


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """The program of a model, and the sizes of its memory."""

    program: Program
    act_whole_max: int  # longest delay of u_c that the memory has room for, ticks
    sense_whole_max: int  # of the readings
    delays: bool  # whether the model has a delay

    @property
    def places(self) -> int:
        """The length of the memory of a simulated rig."""
        return LINES + self.act_whole_max + 2 + 2 * (self.sense_whole_max + 1)


def simulated(model: Model) -> list[tuple[Cause, CauseParameter]]:
    """The parameters of the causes of a model that a simulation has, in the order of the model."""
    causes = [BY_NAME[cause.name] for cause in model.causes if not BY_NAME[cause.name].not_simulated]
    return [(cause, p) for cause in causes for p in cause.parameters if not p.random and p.name != "in_captures"]


def constants(model: Model) -> Mapping[int, float]:
    """Return the places of the vector c that are neutral whatever the parameters are."""
    free = {parameter.index for _, parameter in simulated(model)}
    return {index: float(value) for index, value in enumerate(neutral()) if index not in free}


def plant(model: Model, sample_time_s: float) -> Record:
    """PlantNumbers of the model, as values."""
    c = Cells(parameter("c").node, constants(model))
    # A delay that the model does not have is known to be 0, and its branches vanish.
    delays: dict[str, Value] = {
        f"{where}_{what}": Known(0) if what == "whole" else Known(0.0)
        for where in ("act", "sense", "in")
        for what in ("whole", "part_s")
    }
    for where, index in (("act", ACT), ("sense", SENSE)):
        if index not in c.constants:
            delays[f"{where}_whole"] = Code(parameter(f"{where}_whole").node, "int")
            delays[f"{where}_part_s"] = parameter(f"{where}_part_s")
    base = Record({field: parameter(field) for field in Base._fields})
    fields: dict[str, Value] = {"base": base, "c": c, "sample_time_s": Known(sample_time_s), **delays}
    return Record({field: fields.get(field, Known(False)) for field in PlantNumbers._fields})


def add_begin(program: Program, model: Model, sample_time_s: float) -> Function:
    """Add what fills the memory of a rig to a program."""
    values = [plant(model, sample_time_s), _memory(), *variables_of("i", "x", "v", "u"), Known(-1.0)]
    return program.add(begin, values)


def add_tick(program: Program, model: Model, sample_time_s: float) -> Function:
    """Add one tick of rig and law to a program."""
    law = Record({field: parameter(field) for field in LawNumbers._fields} | {"sample_time_s": Known(sample_time_s)})
    closed_loop = Code(name("closed_loop"), "bool")
    values = [plant(model, sample_time_s), law, _memory(), closed_loop, *variables_of("x_ref", "u")]
    return program.add(advance, values)


def _memory() -> Cells:
    return Cells(name("memory"), {})


def rig(model: Model, sample_time_s: float) -> Rig:
    """Translate what the twin does at the start and in each tick.

    Raises:
        NotTranslatableError: a kernel uses a construct that no other language has.
    """
    program = Program()
    add_begin(program, model, sample_time_s)
    add_tick(program, model, sample_time_s)
    known = constants(model)
    delays = ACT not in known or SENSE not in known
    if delays:
        program.add(delay_in_ticks, [*variables_of("delay_s"), Known(sample_time_s)])
    # Room for the longest delay of the catalogue: in the exported rig it remains a parameter.
    longest = {
        cause.strength.index: math.ceil(cause.strength.high / sample_time_s) + 1 for cause, _ in simulated(model)
    }
    act, sense = longest.get(ACT, 0), longest.get(SENSE, 0)
    return Rig(program=program, act_whole_max=act, sense_whole_max=sense, delays=delays)


def variables_of(*names: str) -> list[Value]:
    """Return numbers that are known at run time only."""
    return [Code(name(key), "float") for key in names]
