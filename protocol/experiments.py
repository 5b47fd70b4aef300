"""The menu of experiments, as a table: signals, durations and purpose.  Pure.

`gateway.campaign` flies them; `twin.diagnosis.experiments` simulates those for fitting, to propose the next one.

Rule 1: inputs are shares of the lift-off input, the u_c that just lifts the ball from its rest.  Positions are shares
        of the travel above the rest.  So one table serves every rig.
Rule 2: recordings for judging are separate experiments with another seed or amplitude than those for fitting.
Rule 3: durations are those of the default run; `quick` is the factor on them for `--quick`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from protocol.campaign import Kind, Use

Shape = Literal["rectangle", "sawtooth", "prbs", "multisine", "chirp"]
Expectation = Literal["rests", "lifts-off", "bounces", "flies", "is-clamped"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CoilOff:
    """A pause in mode idle."""

    duration_s: float
    value: float = 0.0  # share of the lift-off input


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """Open loop with a constant input."""

    value: float  # share of the lift-off input
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Burst:
    """A 25 kHz capture of one step of u_c."""

    u_from: float  # shares of the lift-off input
    u_to: float
    lead_s: float = 0.15  # time at u_from before the capture, for the current to settle


@dataclass(frozen=True, slots=True, kw_only=True)
class Wave:
    """A test signal of the board between two values, on u_c (open loop) or on x_ref (closed loop)."""

    shape: Shape
    low: float  # share of the lift-off input, or of the travel
    high: float
    period_s: float  # for a prbs: of its clock; for a chirp: at its start
    duration_s: float
    on_reference: bool = False
    salt: int = 0  # added to the campaign's seed
    period_end_s: float = 0.0  # chirp


@dataclass(frozen=True, slots=True, kw_only=True)
class Hover:
    """A closed loop with a constant reference."""

    value: float  # share of the travel
    duration_s: float


Signal = CoilOff | Constant | Wave | Hover
Step = Signal | Burst


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """An experiment of the menu, which gives one recording of a campaign."""

    name: str  # also of its file
    kind: Kind
    use: Use
    purpose: str  # its purpose, one sentence
    expects: Expectation
    steps: tuple[Step, ...]
    standard: bool = True  # part of the default run
    quick: float = 0.35  # factor on the durations for `--quick`; 0: not part of it
    person: str = ""  # manual preparation, as an instruction
    instruction: str = ""  # for a user without `board51 campaign`; {low}, {high}, {duration}; of those for fitting
    warms: bool = False  # useful only for causes with heating
    stationary: bool = True  # a part of its signal carries a proportional part of its information

    @property
    def closed_loop(self) -> bool:
        """Return whether the ball flies under the board's law."""
        return self.expects == "flies"

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The steps that last for a stated time: all but the captures."""
        return tuple(step for step in self.steps if not isinstance(step, Burst))

    @property
    def captures(self) -> tuple[tuple[float, float], ...]:
        """The input before and after the step of each 25 kHz capture, shares of the lift-off input."""
        return tuple((step.u_from, step.u_to) for step in self.steps if isinstance(step, Burst))

    @property
    def duration_s(self) -> float:
        """The approximate length of the recording, s."""
        return sum(BURST_S + step.lead_s if isinstance(step, Burst) else step.duration_s for step in self.steps)


BURST_S = 0.58  # transfer time of 1000 samples over the free third of the line
LIFT_OFF = "lift-off"


def _fly(x: float, *steps: Step) -> tuple[Step, ...]:
    return (Hover(value=x, duration_s=0.3), *steps)


def _reference(
    shape: Shape, low: float, high: float, period_s: float, duration_s: float, salt: int = 0
) -> tuple[Step, ...]:
    """Hover in the middle, then the signal."""
    wave = Wave(shape=shape, low=low, high=high, period_s=period_s, duration_s=duration_s, on_reference=True, salt=salt)
    return _fly((low + high) / 2, wave)


def _bursts(*levels: tuple[float, float]) -> tuple[Step, ...]:
    return tuple(Burst(u_from=a, u_to=b) for a, b in levels)


def _levels(*levels: float, each_s: float) -> tuple[Step, ...]:
    return tuple(Constant(value=value, duration_s=each_s) for value in levels)


def _bouncing(duration_s: float, salt: int) -> tuple[Step, ...]:
    # A ball at the top stop falls only with an input far below lift-off (a third of it on a CE 152, near zero on a rig
    # with its coil at the stop).  It takes 0.03 to 0.06 s from stop to stop; a clock of 0.02 s gives the longest
    # flights.
    return (Wave(shape="prbs", low=0.05, high=1.2, period_s=0.02, duration_s=duration_s, salt=salt),)


def _multisines(x: float) -> tuple[Step, ...]:
    """Eight sines from 1 to 8 Hz, then eight from 4 to 32 Hz, of amplitudes within the slew of a CE 152."""
    slow = Wave(shape="multisine", low=x - 0.04, high=x + 0.04, period_s=1.0, duration_s=12.0, on_reference=True)
    fast = Wave(shape="multisine", low=x - 0.02, high=x + 0.02, period_s=0.25, duration_s=20.0, on_reference=True)
    return _fly(x, slow, fast)


_SAME_STEPS = Wave(shape="rectangle", low=0.42, high=0.58, period_s=1.0, duration_s=4.0, on_reference=True)

MENU: tuple[Experiment, ...] = (
    Experiment(
        name=LIFT_OFF, kind="sawtooth", use="fit", expects="lifts-off", quick=0.34,
        purpose="the current that just lifts the ball: K_c by eq. (8); measures the lift-off input for the others",
        instruction="raise u_c slowly from 0 to {high} until the ball leaves its rest, several times",
        steps=(Wave(shape="sawtooth", low=0.0, high=1.1, period_s=3.0, duration_s=10.0),),
    ),
    Experiment(
        name="rest", kind="amplifier-step", use="fit", expects="rests",
        purpose="noise of both sensors with the coil off and under constant currents, the ball at rest",
        instruction="record the ball at rest with the coil off and at two constant inputs up to {high}",
        steps=(CoilOff(duration_s=1.5), *_levels(0.3, 0.6, each_s=1.5)),
    ),
    Experiment(
        name="amplifier-steps", kind="amplifier-step", use="fit", expects="rests", quick=1.0,
        purpose="25 kHz steps up and down below lift-off: K_A from the levels, T_A from the way there, eq. (1)",
        instruction="step u_c between {low} and {high}, the ball at rest, and capture i_c at 25 kHz",
        steps=_bursts((0.0, 0.1), (0.1, 0.35), (0.35, 0.6), (0.6, 0.85), (0.85, 0.35), (0.6, 0.35), (0.1, 0.85),
                      (0.35, 0.1)),
    ),
    Experiment(
        name="amplifier-steps-judge", kind="amplifier-step", use="judge", expects="rests", quick=0.0,
        purpose="other 25 kHz steps, to judge the amplifier",
        steps=_bursts((0.2, 0.75), (0.75, 0.45), (0.45, 0.2)),
    ),
    Experiment(
        name="prbs-open-loop", kind="prbs", use="fit", expects="bounces",
        purpose="the ball flies between the stops: K_c and b by eq. (7) without a controller",
        instruction="let a random u_c between {low} and {high} throw the ball from stop to stop for {duration}",
        steps=_bouncing(8.0, salt=1),
    ),
    Experiment(
        name="prbs-open-loop-judge", kind="prbs", use="judge", expects="bounces", quick=0.0,
        purpose="the same with another sequence, to judge",
        steps=_bouncing(4.0, salt=2),
    ),
    Experiment(
        name="steps", kind="closed-loop", use="fit", expects="flies",
        purpose="small reference steps around the middle: fig. 12 of the paper, the loop near its operating point",
        instruction="step the reference between {low} and {high} for {duration}",
        steps=_reference("rectangle", 0.42, 0.58, 1.0, 8.0),
    ),
    Experiment(
        name="steps-judge", kind="closed-loop", use="judge", expects="flies", quick=0.0,
        purpose="small steps of another size and period, to judge",
        steps=_reference("rectangle", 0.44, 0.6, 1.4, 7.0),
    ),
    Experiment(
        name="wide-steps", kind="closed-loop", use="fit", expects="flies",
        purpose="reference steps over half the travel: the force law over the gap",
        instruction="step the reference over half the travel, between {low} and {high}, for {duration}",
        steps=_reference("rectangle", 0.27, 0.73, 1.4, 8.4),
    ),
    Experiment(
        name="wide-steps-judge", kind="closed-loop", use="judge", expects="flies", quick=0.45,
        purpose="wide steps of another size and period, to judge",
        steps=_reference("rectangle", 0.3, 0.7, 1.2, 6.0),
    ),
    Experiment(
        name="multisine", kind="closed-loop", use="fit", expects="flies",
        purpose="eight frequencies at once on the reference: K_c and b without a favoured frequency",
        instruction="let the reference follow eight sines at once between {low} and {high} for {duration}",
        steps=_reference("multisine", 0.35, 0.65, 2.0, 10.0, salt=3),
    ),
    Experiment(
        name="multisine-judge", kind="closed-loop", use="judge", expects="flies", quick=0.0,
        purpose="other signs, shift and amplitude, to judge",
        steps=_reference("multisine", 0.38, 0.62, 2.0, 6.0, salt=40),
    ),
    Experiment(
        name="prbs-reference", kind="closed-loop", use="fit", expects="flies",
        purpose="a random reference: fast motion, where the drag shows",
        instruction="let the reference jump at random between {low} and {high} for {duration}",
        steps=_reference("prbs", 0.42, 0.58, 0.08, 8.0, salt=5),
    ),
    Experiment(
        name="prbs-reference-judge", kind="closed-loop", use="judge", expects="flies", quick=0.0,
        purpose="another sequence and amplitude, to judge",
        steps=_reference("prbs", 0.43, 0.57, 0.1, 6.0, salt=6),
    ),
    Experiment(
        name="chirp", kind="closed-loop", use="fit", expects="flies", standard=False, quick=1.0,
        purpose="a sine from 0.5 to 10 Hz on the reference: lags and resonances by frequency",
        instruction="let the reference swing between {low} and {high}, from 0.5 Hz up to 10 Hz in {duration}",
        steps=_fly(0.5, Wave(shape="chirp", low=0.47, high=0.53, period_s=2.0, period_end_s=0.1, duration_s=15.0,
                             on_reference=True)),
    ),
    Experiment(
        name="bode-low", kind="closed-loop", use="judge", expects="flies", standard=False, quick=1.0,
        purpose="small multisines from 1 to 32 Hz low in the travel, for frequency responses",
        steps=_multisines(0.35),
    ),
    Experiment(
        name="bode-high", kind="closed-loop", use="judge", expects="flies", standard=False, quick=1.0,
        purpose="the same high in the travel",
        steps=_multisines(0.65),
    ),
    Experiment(
        name="holds", kind="closed-loop", use="fit", expects="flies", standard=False, quick=1.0,
        purpose="seven positions over the travel, each held: force law and sensor against position, at rest",
        instruction="hold the ball for 2.5 s at each of seven heights from {low} to {high}",
        steps=tuple(Hover(value=x, duration_s=2.5) for x in (0.1, 0.22, 0.35, 0.48, 0.61, 0.74, 0.87)),
    ),
    Experiment(
        name="slow-ramp", kind="closed-loop", use="fit", expects="flies", standard=False, quick=1.0,
        purpose="the reference rises slowly and falls back: every position passed, almost at rest",
        instruction="raise the reference slowly from {low} to {high}, two times in {duration}",
        steps=_reference("sawtooth", 0.28, 0.72, 10.0, 20.0),
    ),
    Experiment(
        name="warm-run", kind="closed-loop", use="fit", expects="flies", standard=False, quick=1.0,
        purpose="steps, 60 s held low under a high current, the same steps again: what warming up changes",
        instruction="step the reference, hold the ball at {low} for a minute so that the coil warms up, step again",
        warms=True, stationary=False,
        steps=_fly(0.5, _SAME_STEPS, Hover(value=0.1, duration_s=60.0), Hover(value=0.5, duration_s=0.5), _SAME_STEPS),
    ),
    Experiment(
        name="blocked-ball", kind="amplifier-step", use="fit", expects="is-clamped", standard=False, quick=1.0,
        person="Clamp the ball so that it cannot move (a shim between ball and coil housing).",
        purpose="steps of u_c with the ball clamped: the amplifier alone, up to inputs at which a free ball would fly",
        instruction="clamp the ball (a shim between ball and coil housing) and step u_c between {low} and {high}",
        steps=(*_levels(0.2, 0.6, 1.1, 0.8, 0.4, each_s=1.0), *_bursts((0.1, 1.1), (1.1, 0.5), (0.5, 0.1))),
    ),
)  # fmt: skip
EXPERIMENT_OF_NAME = {experiment.name: experiment for experiment in MENU}
