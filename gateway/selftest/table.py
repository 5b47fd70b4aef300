"""The table of checks, in the order in which they run.

Each finds what the next ones need; the ball is lifted only where STOP was seen to act.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gateway.selftest.bench import Bench
from gateway.selftest.checks.calibration import calibration
from gateway.selftest.checks.codes import codes
from gateway.selftest.checks.converters import converters
from gateway.selftest.checks.health import health
from gateway.selftest.checks.identity import identity
from gateway.selftest.checks.latency import latency
from gateway.selftest.checks.link import link
from gateway.selftest.checks.load import load
from gateway.selftest.checks.polarity import polarity
from gateway.selftest.checks.safety import safety
from gateway.selftest.checks.staircase import staircase
from gateway.selftest.verdict import Verdict


@dataclass(frozen=True, slots=True)
class Check:
    """A row of the table."""

    name: str
    summary: str
    run: Callable[[Bench], Iterator[Verdict]]
    current: bool  # current flows through the coil


CHECKS = (
    Check("link", "answers, PINGs, lost and damaged frames, the board's clock", link, current=False),
    Check("identity", "firmware, scalings, stored settings", identity, current=False),
    Check("converters", "noise and offset with u_c = 0, a sensor that is unplugged", converters, current=False),
    Check("staircase", "K_A, linearity, dead zone, saturation", staircase, current=True),
    Check("safety", "STOP, loss of the host and RESET switch the coil off", safety, current=True),
    Check("polarity", "short pulses lift the ball, and x rises", polarity, current=True),
    Check("latency", "T_A from captures, the delay of the loop", latency, current=True),
    Check("calibration", "x at both stops; --calibrate corrects it", calibration, current=True),
    Check("codes", "bits of the converters that are stuck", codes, current=True),
    Check("load", "a full line: counters, states, STOP", load, current=True),
    Check("health", "the stack's least room, the input at power-on", health, current=False),
)
