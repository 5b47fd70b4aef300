"""The bench that the checks share: the connection, the rig's numbers, what is known, small safe moves of the input.

Rule 1: u_c is at most the rig's `top_input_v` and the board's own u_max.
Rule 2: an input that may lift the ball is a pulse whose duration the board counts.  An excitation ends at its offset,
        which is half the pulse: at that a ball at the bottom stays there.  The host then sends 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import fmean, stdev

from gateway.board.scaling import Scaling, scaling_of
from gateway.selftest.connection import BOOT_S, Connection
from gateway.selftest.rigs import RigNumbers
from gateway.selftest.verdict import fault
from protocol.wire.events import BoardEvent, Sample
from protocol.wire.messages import HostLoss, Message, Mode, Shape

HOST_LOSS_MS = 500  # the board's own after a reset
CUT = "CUT THE SUPPLY OF THE COIL, then look at driver and input converter"
_SETTLE_S = 0.15  # a ball that was lifted a millimetre is at rest again


class NotReadyError(Exception):
    """Something that a check needs is missing; its text is the reason why the check is skipped."""


class FaultFoundError(Exception):
    """A fault ends a check; its arguments are those of `fault`."""

    def __init__(self, name: str, what: str, value: str, *, bound: str = "", remedy: str) -> None:
        super().__init__(what)
        self.verdict = fault(name, what, value, bound=bound, remedy=remedy)


@dataclass(frozen=True, slots=True)
class Rest:
    """Readings with u_c = 0 and the ball at the bottom: mean and standard deviation, A and m."""

    i_a: float
    i_deviation_a: float
    x_m: float
    x_deviation_m: float
    samples: Sequence[Sample]


@dataclass(slots=True)
class Begin:
    """The answers of the board when it was called and restarted."""

    answer_s: float = 0.0  # from the opened port to the first answer
    identity: Message | None = None  # of the first answer
    boot_s: float | None = None  # from the ACK of RESET to the next answer
    events: Sequence[BoardEvent] = ()  # of the boot


@dataclass(slots=True, kw_only=True)
class Bench:
    """A run of the self-test."""

    line: Connection
    rig: RigNumbers
    port: str = ""  # as it was given, for commands to copy
    baud: int = 115200  # bit/s
    quick: bool = False  # fewer repetitions
    calibrate: bool = False  # correct the board's position sensor where it is off
    progress: Callable[[str, float], None] = lambda _text, _share: None  # the present step, and the share done, 0 to 1
    begin: Begin = field(default_factory=Begin)
    parameters: Message | None = None
    lift_input_v: float = 0.0  # has lifted the ball; 0: use that of the rig
    faults: set[str] = field(default_factory=set)  # so far: a check that could only find one again is skipped
    expected_resets: int = 0
    expected_host_losses: int = 0
    _rest: Rest | None = None
    _scaling: Scaling | None = None

    def connect(self) -> None:
        """Call the board, stop it, and restart it, so that its state is known."""
        started_s = self.line.wire.now_s()
        if not self.line.open():
            return
        self.begin.answer_s = self.line.wire.now_s() - started_s
        if self.line.version_refused is not None:
            return
        self.begin.identity = self.line.identities[-1][1]
        self.line.stop()
        first = len(self.line.events)
        self.begin.boot_s = self.restart()
        self.line.run(0.1)  # events come after answers
        self.begin.events = self.line.events[first:]
        self.parameters = self.line.order("GET_PARAMETERS")
        self.set_host_loss(HOST_LOSS_MS)

    def restart(self) -> float | None:
        """Let the board restart; return how long it did not answer, s, or None if it does not come back."""
        self.expected_resets += 1
        self.line.order("RESET")
        started_s, handshakes = self.line.wire.now_s(), len(self.line.identities)
        if not self.line.until(lambda: len(self.line.identities) > handshakes, BOOT_S):
            return None
        return self.line.identities[-1][0] - started_s

    @property
    def identity(self) -> Message:
        """The newest IDENTITY."""
        if not self.line.identities:
            raise NotReadyError("the board does not answer")
        return self.line.identities[-1][1]

    @property
    def scaling(self) -> Scaling:
        """The board's scalings."""
        if self._scaling is None:
            scaling = scaling_of(self.identity)
            if isinstance(scaling, str):
                raise NotReadyError("the board's scalings are not usable")
            self._scaling = scaling
        return self._scaling

    def set_host_loss(self, timeout_ms: int) -> None:
        """Let the board switch its coil off without a host."""
        self.line.order("SET_HOST_LOSS", policy=int(HostLoss.COIL_OFF), timeout=timeout_ms)

    def rest(self) -> Rest:
        """Return the readings at rest; measure them if they are not known yet."""
        if self._rest is None:
            self.idle()
            self.line.run(_SETTLE_S)
            samples = self.line.run(0.5 if self.quick else 2.0)
            if len(samples) < 100:
                raise too_few_states(len(samples))
            i_a, x_m = self.currents(samples), self.positions(samples)
            self._rest = Rest(fmean(i_a), stdev(i_a), fmean(x_m), stdev(x_m), samples)
        return self._rest

    def forget_rest(self) -> None:
        """Let `rest` measure again, because the board's readings have changed."""
        self._rest = None

    def no_current(self) -> Exception:
        """Return what to raise where no current flows: a fault, unless it is known."""
        if self.faults & {"no-current", "input-not-followed"}:
            return NotReadyError("no current flows: see staircase")
        remedy = "look at the coil and its wires, its supply, the driver and the shunt"
        return FaultFoundError("no-current", "i_c", "does not follow u_c", remedy=remedy)

    def currents(self, samples: Sequence[Sample]) -> list[float]:
        """Return i_c of samples, A."""
        return [self.scaling.i_a(sample.state.i_c) for sample in samples]

    def positions(self, samples: Sequence[Sample]) -> list[float]:
        """Return x of samples, m."""
        return [self.scaling.x_m(sample.state.x) for sample in samples]

    def input_count(self, u_v: float) -> int:
        """Return the count of an input, within what rig and board allow."""
        scaling, top = self.scaling, self.top_count
        count = round((min(u_v, self.rig.top_input_v) - scaling.u_offset_v) / scaling.u_lsb_v)
        return min(max(count, 0), top) & ~1  # even: a pulse is twice its half

    @property
    def top_count(self) -> int:
        """The board's own u_max."""
        if self.parameters is None:
            raise NotReadyError("the board's parameters are not known")
        return self.parameters.int("u_max")

    def open_loop(self) -> None:
        """Enter open loop, with u_c at 0; a fault is cleared."""
        self.line.order("SET_MODE", mode=int(Mode.OPEN_LOOP))

    def idle(self) -> None:
        """Switch the coil off."""
        self.line.order("SET_MODE", mode=int(Mode.IDLE))

    def level(self, u_v: float, duration_s: float) -> list[Sample]:
        """Hold an input at which the ball stays at rest; return the samples at which it was in force for a tick."""
        count = self.input_count(min(u_v, self.rig.rest_input_v))
        self._excite(Shape.NONE, amplitude=0, offset=count)
        return at_input(self.line.run(duration_s), count)

    def pulse(self, u_v: float, ticks: int, then_s: float = _SETTLE_S) -> list[Sample]:
        """Apply an input for a number of ticks, then 0; return the samples from its start until `then_s` after it."""
        half = self.input_count(u_v) // 2
        first = len(self.line.samples)
        ack = self._excite(Shape.STEP, amplitude=half, offset=half, duration=ticks + 1)
        self.line.run((ticks + 1) * self.scaling.sample_time_s)
        self._excite(Shape.NONE, amplitude=0, offset=0)
        self.line.run(then_s)
        start = ack.int("tick")
        return [sample for sample in self.line.samples[first:] if sample.tick >= start]

    def play(self, shape: Shape, u_v: float, *, period_s: float, duration_s: float) -> list[Sample]:
        """Play a signal between 0 and `u_v` once; return its samples."""
        half = self.input_count(min(u_v, self.rig.rest_input_v)) // 2
        period, duration = (round(s / self.scaling.sample_time_s) for s in (period_s, duration_s))
        self._excite(shape, amplitude=half, offset=half, period=period, duration=duration)
        samples = self.line.run(duration_s)
        self._excite(Shape.NONE, amplitude=0, offset=0)
        return samples

    def _excite(self, shape: Shape, *, amplitude: int, offset: int, period: int = 1, duration: int = 0) -> Message:
        return self.line.order(
            "EXCITE", shape=int(shape), target=0, amplitude=amplitude, offset=offset, period=period, period_end=1,
            seed=1, duration=duration,
        )  # fmt: skip


def too_few_states(count: int) -> FaultFoundError:
    """Return what to raise where states are missing."""
    return FaultFoundError("no-states", "states", f"only {count}", remedy="the line loses them: see link")


def at_input(samples: Sequence[Sample], count: int) -> list[Sample]:
    """Return the samples whose current has followed this input: it was in force at the two ticks before."""
    triples = zip(samples, samples[1:], samples[2:], strict=False)
    return [c for a, b, c in triples if a.state.u_c == b.state.u_c == count and c.tick == a.tick + 2]
