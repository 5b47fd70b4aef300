"""Effects of the second plant alone.  The catalogue does not know them, and the honest answer is `unknown-cause`.

One that the catalogue has learnt keeps its seeds here; its answer is then that `cause`.

Each is physically plausible, clearly above the noise at its strength, and leaves the ball flying
(`test_hidden_campaigns.py`).  The equations are in `second_plant.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True, kw_only=True)
class Outside:
    """An effect: its strength and what it does."""

    strength: float
    unit: str
    meaning: str
    cause: str = ""  # of the catalogue that is right for it
    may_be_adequate: bool = False  # a diagnosis that leaves the damaged samples out finds a right model


OUTSIDE: Mapping[str, Outside] = MappingProxyType(
    {
        "force-hysteresis": Outside(
            strength=0.03,
            unit="A",
            meaning="the field follows the current with a play of this half width: a loop of remanence, not an offset",
            cause="magnetic-hysteresis",
        ),
        "sensor-sticks": Outside(
            strength=40e-6, unit="m", meaning="the reading moves only when x has moved by this much (a worn guide)"
        ),
        "sensor-warm-up": Outside(
            strength=250e-6, unit="m", meaning="x reads too high by this much after a warm-up of 40 s, 0 at the start"
        ),
        "wire-spring": Outside(
            strength=1.5e6,
            unit="N/m^3",
            meaning="a wire on the ball: slack below 2.5 mm, then a force down with the cube of the way",
        ),
        "lateral-resonance": Outside(
            strength=1.1,
            unit="",
            meaning="the ball swings sideways at 35 Hz, driven by its acceleration, and the sensor takes it for height",
        ),
        "sensor-hum": Outside(
            strength=20e-6,
            unit="m",
            meaning="the reading of x swings by this much at 50 Hz, the mains",
            cause="position-sensor-line",
        ),
        "spring-of-a-cable": Outside(
            strength=5.0, unit="N/m", meaning="the cable of the rig hangs on the ball: a force down, in proportion to x"
        ),
        "supply-sag": Outside(
            strength=0.08,
            unit="1/A",
            meaning="the supply gives in under load, within 1.5 s: K_A falls with the current",
            cause="amplifier-gain-drift",
        ),
        "supply-ripple": Outside(
            strength=0.04, unit="", meaning="the amplifier's gain swings by this share at 100 Hz, twice the mains"
        ),
        "friction-patch": Outside(
            strength=0.006, unit="N", meaning="dry friction between 2.25 and 2.55 mm only: a scratch in the guide"
        ),
        "loose-contact": Outside(
            strength=0.04,
            unit="",
            meaning="the gain of the amplifier falls by this share and comes back, at random times",
        ),
        "bit-errors": Outside(
            strength=0.01,
            unit="",
            meaning="with this probability per sample one of bits 4 to 8 of x is wrong, for the law too",
            may_be_adequate=True,
        ),
    }
)
