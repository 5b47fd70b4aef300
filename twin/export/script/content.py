"""The parts of a script in any language: programs of the twin's functions, numbers, sentences."""

from __future__ import annotations

from dataclasses import dataclass

from twin.export.controller import Controller
from twin.export.linear import Linear, linear
from twin.export.rig import MEMORY, law, plant, variables_of
from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import Cells, Code, Known, name
from twin.export.variables import Variable, of_law, parameters, title
from twin.mirror.loop import advance
from twin.model.parameters import Model
from twin.model.rates import rates, readings, without_equation
from twin.model.simulate import begin, left_out, places, plant_numbers

STEP_SHARE = 0.1  # of the travel: steps of the reference in figure 11


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """A model for the writers of scripts."""

    model: Model
    controller: Controller
    title: str
    listed: tuple[Variable, ...]  # parameters and law, with units and descriptions
    delays: tuple[tuple[str, float], ...]  # whole ticks and the rest of each delay, s
    places: int  # of the memory
    linear: Linear

    def begin(self) -> tuple[Program, Function]:
        """The program that fills the memory of a rig, and its function."""
        program = Program()
        memory = Cells(name(MEMORY), {})
        numbers = plant(self.model, self.controller.sample_time_s)
        return program, program.add(begin, [numbers, memory, *variables_of("i", "x", "v", "u"), Known(-1.0)])

    def tick(self) -> tuple[Program, Function]:
        """The program of one tick, and its function."""
        T_s, program = self.controller.sample_time_s, Program()
        memory, closed = Cells(name(MEMORY), {}), Code(name("closed_loop"), "bool")
        values = [plant(self.model, T_s), law(T_s), memory, closed, *variables_of("x_ref", "u")]
        return program, program.add(advance, values)

    def rates(self) -> tuple[Program, Function, Function]:
        """The program of the differential equation, and its functions: rates and readings."""
        program = Program()
        numbers = plant(self.model, self.controller.sample_time_s).fields
        p, c = numbers["base"], numbers["c"]
        right = program.add(rates, [p, c, *variables_of("i", "x", "v", "u")])
        return program, right, program.add(readings, [p, c, *variables_of("i", "x")])

    @property
    def without_rates(self) -> tuple[str, ...]:
        """The sentences on why the model has no differential equation; empty: it has one."""
        return tuple(without_equation(self.model))

    @property
    def notes(self) -> tuple[str, ...]:
        """The sentences on what is left out."""
        return tuple(left_out(self.model))


def content(model: Model, controller: Controller) -> Content:
    """Prepare a model for the writers of scripts."""
    numbers = plant_numbers(model, controller.sample_time_s)
    names = "act_whole", "act_part_s", "sense_whole", "sense_part_s"
    return Content(
        model=model,
        controller=controller,
        title=title(model),
        listed=(*parameters(model), *of_law(controller.numbers)),
        delays=tuple((key, getattr(numbers, key)) for key in names),
        places=places(numbers),
        linear=linear(model, controller),
    )
