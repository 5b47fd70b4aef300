"""The table of effects: behaviour of real rigs beyond eq. (1) and (6).

Each effect has ONE number, its own physical parameter in the unit given here; numbers that an effect needs besides
(a heating time constant, a frequency) are fixed below.  An effect that is not named has its `neutral` value and is then
exactly absent.  `physics.py` holds the equations; `where` says which line of it.

Rule 1: the names are those of the catalogue of causes (design.md), so that a diagnosis can be compared.
Rule 2: effects combine freely.  Delays are rounded to the plant's step of 20 us.
Rule 3: weak shows only in careful statistics, medium in a plot, strong at once; a nominal LQI still holds the ball
        under any single one of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from protocol.errors import UsageError

HEATING_TIME_CONSTANT_S = 30.0  # amplifier-gain-drift; minutes on a real coil, shortened to fit a recording
DISTURBANCE_FREQUENCY_HZ = 7.0  # periodic-disturbance: a table that rocks; inside the bandwidth of the position loop
MAX_DELAY_S = 20e-3  # actuation-delay, sampling-delay: ten ticks


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect: its parameter, the range of its values, and its description; a row of the table."""

    name: str
    parameter: str
    unit: str  # empty: a pure number
    low: float  # smallest possible value
    high: float  # largest possible value
    weak: float
    medium: float
    strong: float
    description: str
    where: str
    source: str
    family: str  # amplifier | force | motion | sensing | timing
    neutral: float = 0.0  # the value at which the effect is absent
    signed: bool = False  # the value mirrored at the neutral one is as plausible


# fmt: off
# columns: name, parameter, unit, low, high, weak, medium, strong, what it does, where it acts, source
_TABLE = (
    # --- amplifier
    Effect("amplifier-gain-drift", "loss", "1/A^2", 0.0, 0.3, 0.02, 0.06, 0.15,
           "the coil heats and the gain falls: K_A (1 - loss w), 30 s w' + w = i^2; loss at a steady 1 A",
           "target current", "coil heating, which the paper neglects on purpose", family="amplifier"),
    Effect("current-limit", "limit", "A", 0.05, 1.5, 1.3, 1.15, 1.02,
           "the amplifier gives no more than this current (the ball lifts off at 0.98 A)",
           "target current and its rate", "a power supply smaller than the rig's",
           family="amplifier", neutral=math.inf),
    Effect("slew-rate-limit", "rate", "A/s", 1.0, 100000.0, 300.0, 100.0, 30.0,
           "the current changes no faster than this, in both directions",
           "rate of the current", "coil voltage is finite: di/dt <= U/L", family="amplifier", neutral=math.inf),
    Effect("amplifier-dead-zone", "width", "V", 0.0, 2.0, 0.05, 0.15, 0.4,
           "no current below this input; above it, the input acts as if smaller by as much",
           "target current", "threshold of the output stage; assumed size", family="amplifier"),
    Effect("amplifier-offset", "offset", "A", -0.3, 0.3, 0.01, 0.03, 0.08,
           "target current is K_A u + offset, never below 0",
           "target current", "offset of the output stage; an INTECO rig gives 0.043 A at zero input",
           family="amplifier", signed=True),
    Effect("position-dependent-inductance", "growth", "", 0.0, 10.0, 0.3, 1.0, 3.0,
           "T_A grows towards the coil by 1/gap: T_A at the bottom stop, T_A (1 + growth) at the top stop",
           "rate of the current", "L = L_0 + 2 K_c/gap goes with eq. (3) by energy; neglected by the paper on purpose",
           family="amplifier"),
    Effect("motional-emf", "coupling", "s/m", 0.0, 10.0, 0.05, 0.2, 1.0,
           "a rising ball pushes the current down: T_A i' + i = K_A u - coupling i v (gap_mid/gap)^2",
           "rate of the current", "i v dL/dx over the resistance, dL/dx = 2 K_c/gap^2; about 0.04 s/m with 10 ohm",
           family="amplifier"),
    Effect("actuation-delay", "delay", "s", 0.0, MAX_DELAY_S, 0.0004, 0.001, 0.002,
           "the input acts this much later",
           "input", "computing time between sampling and output; up to one tick", family="amplifier"),
    # --- force
    Effect("air-gap-offset", "d", "m", -0.002, 0.005, 0.0001, 0.0003, 0.0008,
           "the coil's plane is this much higher than the rig says",
           "magnetic force", "the measured equilibria need 2.4 mm against eq. (3); this comes on top",
           family="force", signed=True),
    Effect("force-exponent", "n", "", 1.0, 4.0, 2.1, 2.4, 3.0,
           "force falls with gap^n instead of gap^2; unchanged in the middle of the travel",
           "magnetic force", "iron paths of finite size give other powers than 2; assumed size",
           family="force", neutral=2.0),
    Effect("core-saturation", "i_s", "A", 0.3, 20.0, 3.0, 2.0, 1.5,
           "the force sees i / sqrt(1 + (i/i_s)^2)",
           "magnetic force", "iron saturates; the smaller i_s, the earlier", family="force", neutral=math.inf),
    Effect("residual-magnetism", "i_r", "A", -0.3, 0.3, 0.01, 0.03, 0.08,
           "a constant field as from this current, which the current sensor does not see; no hysteresis loop",
           "magnetic force", "remanence of core and ball; assumed size", family="force"),
    Effect("eddy-current-lag", "tau", "s", 5e-05, 0.02, 0.0005, 0.0015, 0.004,
           "the force sees the current through a first-order lag",
           "magnetic force", "eddy currents in a solid core; assumed size", family="force"),
    # --- motion
    Effect("quadratic-drag", "c", "N s^2/m^2", 0.0, 20.0, 0.2, 1.0, 4.0,
           "additional drag c |v| v",
           "net force", "neglected by the paper on purpose; air alone gives 4e-5, a guide tube far more",
           family="motion"),
    Effect("coulomb-friction", "force", "N", 0.0, 0.05, 0.0005, 0.002, 0.006,
           "dry friction against the motion; holds a resting ball against smaller forces",
           "net force", "a ball that touches its guide; weight is 0.081 N", family="motion"),
    Effect("constant-force", "force", "N", -0.05, 0.05, 0.001, 0.004, 0.01,
           "a force on the ball, up if positive",
           "net force", "wrong mass, a tilted rig, a draught; weight is 0.081 N", family="motion", signed=True),
    Effect("periodic-disturbance", "amplitude", "N", 0.0, 0.05, 0.0005, 0.002, 0.008,
           "a sinusoidal force at 7 Hz, phase 0 at time 0",
           "net force", "floor vibration, a fan", family="motion"),
    # --- sensing
    Effect("position-sensor-offset", "offset", "m", -0.002, 0.002, 5e-05, 0.0002, 0.0006,
           "x reads this much too high",
           "position sensor", "assumed size", family="sensing", signed=True),
    Effect("position-sensor-gain", "gain", "", 0.5, 1.5, 0.98, 0.94, 0.85,
           "x reads gain times itself",
           "position sensor", "published sensor slopes of the CE 152 differ: 800 .. 870 V/m",
           family="sensing", neutral=1.0, signed=True),
    Effect("position-sensor-nonlinearity", "bow", "m", -0.001, 0.001, 3e-05, 0.0001, 0.0003,
           "x reads too high by bow in the middle, right at both stops (a parabola)",
           "position sensor", "inductive sensors are calibrated at two points", family="sensing", signed=True),
    Effect("position-sensor-lag", "tau", "s", 5e-05, 0.02, 0.0004, 0.001, 0.0025,
           "x is read through a first-order lag",
           "position sensor", "demodulator and anti-alias filter; assumed size", family="sensing"),
    Effect("sensor-crosstalk", "coupling", "m/A", -0.002, 0.002, 2e-05, 6e-05, 0.00015,
           "the coil's current shows in x",
           "position sensor", "an inductive sensor in the coil's stray field", family="sensing", signed=True),
    Effect("current-sensor-offset", "offset", "A", -0.3, 0.3, 0.01, 0.03, 0.08,
           "i_c reads this much too high",
           "current sensor", "assumed size", family="sensing", signed=True),
    Effect("current-sensor-gain", "gain", "", 0.5, 1.5, 0.98, 0.94, 0.85,
           "i_c reads gain times itself",
           "current sensor", "tolerance of the shunt", family="sensing", neutral=1.0, signed=True),
    # --- timing
    Effect("sampling-delay", "delay", "s", 0.0, MAX_DELAY_S, 0.0004, 0.001, 0.002,
           "both sensors show the values of this much earlier",
           "sense()", "sample-and-hold and multiplexing before conversion", family="timing"),
    Effect("lost-samples", "probability", "", 0.0, 0.9, 0.005, 0.02, 0.1,
           "each state frame is lost with this probability, independently",
           "drop_sample()", "an overrun buffer on the board", family="timing"),
)
# fmt: on

EFFECTS: Mapping[str, Effect] = MappingProxyType({effect.name: effect for effect in _TABLE})
NEUTRAL: Mapping[str, float] = MappingProxyType({effect.name: effect.neutral for effect in _TABLE})


def check(effects: Mapping[str, float]) -> dict[str, float]:
    """Check effects, and return the strengths of all effects; those that are not named have their neutral value.

    Raises:
        UsageError: a name is unknown, or a value is outside low .. high and not the neutral one.
    """
    strengths = dict(NEUTRAL)
    for name, value in effects.items():
        effect = _find(name)
        if value != effect.neutral and not effect.low <= value <= effect.high:
            raise UsageError(
                f"Effect {name}: {effect.parameter} = {_quantity(value, effect)} is out of range",
                remedy=f"Give {effect.low:g} .. {_quantity(effect.high, effect)}"
                f" (weak {effect.weak:g}, medium {effect.medium:g}, strong {effect.strong:g})",
            )
        strengths[name] = float(value)
    return strengths


def parse(assignment: str) -> tuple[str, float]:
    """Parse a command-line argument `name=value` or `name=weak|medium|strong` into (name, strength).

    Raises:
        UsageError: the argument has another form, or the name is unknown, or the value is out of range.
    """
    name, equals, text = (part.strip() for part in assignment.partition("="))
    effect = _find(name)
    grades = {"weak": effect.weak, "medium": effect.medium, "strong": effect.strong}
    try:
        value = grades[text] if text in grades else float(text)
    except ValueError:
        number = f"a number in {effect.unit}" if effect.unit else "a number"
        raise UsageError(
            f"Effect {assignment!r}: {'no value' if not (equals and text) else f'{text!r} is not a number'}",
            remedy=f"Write {name}=weak, medium, strong or {number}, as in {name}={effect.medium:g}",
        ) from None
    check({name: value})
    return name, value


def listing() -> str:
    """Return the table as text for a help page: one line per effect, by family."""
    lines = []
    family = ""
    for effect in _TABLE:
        if effect.family != family:
            family = effect.family
            lines.append(f"{family}:")
        values = f"{effect.parameter} = {effect.weak:g} | {effect.medium:g} | {_quantity(effect.strong, effect)}"
        lines.append(f"  {effect.name:<30} {values:<34} {effect.description}")
    return "\n".join(lines)


def _quantity(value: float, effect: Effect) -> str:
    return f"{value:g} {effect.unit}".rstrip()


def _find(name: str) -> Effect:
    if name not in EFFECTS:
        raise UsageError(f"There is no effect {name!r}", remedy=f"Choose from {', '.join(EFFECTS)}")
    return EFFECTS[name]
