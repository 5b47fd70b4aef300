"""The parts of a script in any language: programs of the twin's functions, numbers, sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.errors import UsageError
from twin.control import discrete, linearise
from twin.control_design.gains import without_lags
from twin.estimation.record import FloatArray
from twin.export.controller import Controller
from twin.export.rig import add_begin, add_tick, plant, variables_of
from twin.export.translate.specialise import Function, Program
from twin.export.variables import Variable, of_law, parameters, title
from twin.model.linear import delay_s
from twin.model.parameters import Model
from twin.model.rates import rates, readings, without_equation
from twin.model.simulate import left_out, places, plant_numbers

STEP_SHARE = 0.1  # of the travel: steps of the reference in figure 11


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """(14) and (15); the first three states are the readings of i_c and x and the speed, in A, m, m/s."""

    A: FloatArray  # of the model without delays, shape (n, n)
    B: FloatArray  # shape (n, 1)
    delay_s: float  # from u_c to the readings
    Phi: FloatArray  # with delays as further states
    Gamma: FloatArray
    Phi_prompt: FloatArray  # without what no channel measures, shape (3, 3): the plant of (18)
    Gamma_prompt: FloatArray


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
        return program, add_begin(program, self.model, self.controller.numbers.sample_time_s)

    def tick(self) -> tuple[Program, Function]:
        """The program of one tick, and its function."""
        program = Program()
        return program, add_tick(program, self.model, self.controller.numbers.sample_time_s)

    def rates(self) -> tuple[Program, Function, Function]:
        """The program of the differential equation, and its functions: rates and readings."""
        program = Program()
        numbers = plant(self.model, self.controller.numbers.sample_time_s).fields
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
    numbers = plant_numbers(model, controller.numbers.sample_time_s)
    names = "act_whole", "act_part_s", "sense_whole", "sense_part_s"
    return Content(
        model=model,
        controller=controller,
        title=title(model),
        listed=(*parameters(model), *of_law(controller.numbers)),
        delays=tuple((key, getattr(numbers, key)) for key in names),
        places=places(numbers),
        linear=_linear(model, controller),
    )


def _linear(model: Model, controller: Controller) -> Linear:
    """Linearise and discretise a model about the operating point of its controller.

    Raises:
        UsageError: the model has no equilibrium there.
    """
    x, T_s = controller.numbers.x_0, controller.numbers.sample_time_s
    A, B = linearise(model, x)
    if not np.isfinite(A).all():
        raise UsageError(
            f"the model has no equilibrium at x = {x:g} m, the operating point of the controller",
            remedy="Give a controller that was designed for this model",
        )
    whole = discrete(model, x, T_s)
    prompt = discrete(without_lags(model), x, T_s)
    return Linear(
        A=A,
        B=B,
        delay_s=delay_s(model) if model.causes else 0.0,
        Phi=whole[0],
        Gamma=whole[1],
        Phi_prompt=prompt[0],
        Gamma_prompt=prompt[1],
    )
