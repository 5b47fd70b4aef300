"""A twin that names causes, on an emulated rig: effects begin and end in its plant, samples alone come out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from typing import ParamSpec, TypeVar

from gateway.emulator.firmware_model.flash import CURRENT, INPUT, POSITION
from gateway.emulator.plant.constants import CE152
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Mode, Shape
from tests.harness.twin.emulated_campaign import TICK_S, Lab
from tests.harness.twin.true_model import true_model
from twin.live.naming.namer import Namer
from twin.mirror.mirror import Mirror
from twin.model.parameters import Model

MIDDLE_M = 2.85e-3
_MODES = {Mode.IDLE: pb.MODE_IDLE, Mode.OPEN_LOOP: pb.MODE_OPEN_LOOP, Mode.CLOSED_LOOP: pb.MODE_CLOSED_LOOP}
P = ParamSpec("P")
T = TypeVar("T")


class AtOnce(Executor):
    """Does the work in the caller's thread."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class NamedFlight:
    """Steps of the reference once a second around the middle, and what the twin names."""

    def __init__(self, *, seed: int = 3, model: Model | None = None, step_m: float = 0.5e-3) -> None:
        self.lab = Lab(CE152, seed=seed)
        self.messages: list[pb.TwinDiagnosis] = []
        self.states: list[pb.State] = []
        self.model = model or true_model()
        self.namer = Namer(self.model, AtOnce())
        self.mirror = Mirror(self.model)
        self.now_s = 0.0  # of the newest sample, on the board's clock
        self.lift(step_m)

    def lift(self, step_m: float = 0.5e-3) -> None:
        """Put the ball into flight, and step the reference."""
        self.lab.fly(MIDDLE_M)
        self.lab.run(400)
        if step_m == 0.0:
            return
        self.lab.excite(
            Shape.RECTANGLE,
            on_reference=True,
            amplitude=POSITION.span(step_m),
            offset=POSITION.to_count(MIDDLE_M),
            period=500,
            seed=5,
        )

    def begin(self, effects: Mapping[str, float]) -> None:
        """Change the rig from now on; nobody else hears of it."""
        self.lab.plant.set_effects(effects)

    def run(self, seconds: float) -> list[pb.TwinDiagnosis]:
        """Fly on; the new messages."""
        count = len(self.messages)
        for sample in self.lab.states(round(seconds / TICK_S)):
            state = pb.State(
                sequence=sample.sequence,
                tick=sample.sequence,
                session=1,
                t_s=sample.sequence * TICK_S,
                host_time_ns=round(sample.sequence * TICK_S * 1e9),
                i_c_a=CURRENT.to_si(sample.i_c),
                x_m=POSITION.to_si(sample.x),
                u_c_v=INPUT.to_si(sample.u_c),
                x_ref_m=POSITION.to_si(sample.x_ref),
                mode=_MODES[Mode(sample.flags & 3)],
                flags=sample.flags & ~3,
            )
            self.take(state)
        return self.messages[count:]

    def take(self, state: pb.State) -> None:
        """Give one sample to the twin."""
        self.states.append(state)
        output = self.mirror.handle(state)
        if output is not None:
            message = self.namer.take(state, output, self.mirror.regime)
            if message is not None:
                self.messages.append(message)
        self.now_s = state.t_s


def causes_of(message: pb.TwinDiagnosis) -> set[str]:
    """Return the named cause and those that these samples do not tell from it."""
    return {message.cause, *message.others}
