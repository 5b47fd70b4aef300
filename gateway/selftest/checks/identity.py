"""The board's words of itself: program, scalings, stored settings."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.board.scaling import Scaling, scaling_of
from gateway.selftest.bench import Bench
from gateway.selftest.rigs import RIGS, RigNumbers
from gateway.selftest.verdict import Verdict, fault, judge, passed, warning
from protocol.wire.messages import COUNTS_MAX, EventCode, Message

_ROOM = 10.0  # largest ratio of a converter's range to what the rig needs
_CORRECT = "correct the numbers in its firmware or EEPROM and flash it"


def identity(bench: Bench) -> Iterator[Verdict]:
    """Judge IDENTITY, PARAMETERS and the events of the boot."""
    message = bench.identity
    build = message.bytes("build").decode("ascii", "replace").strip()
    yield passed(
        "program",
        "protocol, firmware, build",
        f"{message.int('version')}, {message.int('firmware_major')}.{message.int('firmware_minor')}, {build}",
    )
    if bench.begin.identity is not None and bench.begin.identity.int("reset_cause") == EventCode.RESET_WATCHDOG:
        # The boot loader of a board that `board51 flash` writes hides the cause of a reset by DTR.
        name, what = "reset-cause", "cause of the reset before"
        if bench.rig.flash_board:
            yield passed(name, what, "watchdog")
        else:
            remedy = "a boot loader may cause this; without one the firmware hangs"
            yield warning(name, what, "watchdog", remedy=remedy)
    yield judge(
        "sample-time", "T_s", message.int("sample_time") / 1e3, "ms", good=(2.0, 2.0), possible=(0.5, 20.0),
        remedy="the gains and this test are made for 2 ms",
    )  # fmt: skip
    scaling = scaling_of(message)
    if isinstance(scaling, str):
        yield fault("scalings", "scalings", scaling.partition(".  ")[0], remedy=_CORRECT)
        return
    yield _range_verdict(scaling, bench.rig)
    yield from _settings(bench, scaling)


def _range_verdict(scaling: Scaling, rig: RigNumbers) -> Verdict:
    current, span_m, input_v = scaling.i_a(COUNTS_MAX), abs(COUNTS_MAX * scaling.x_lsb_m), scaling.u_v(COUNTS_MAX)
    value = f"i_c to {current:.4g} A, x over {1e3 * span_m:.3g} mm, u_c to {input_v:.3g} V"
    shares = (current / (rig.K_A * rig.top_input_v), span_m / rig.travel_m, input_v / rig.lift_input_v)
    if all(0.95 <= share <= _ROOM for share in shares):
        return passed("scalings", "ranges of the converters", value)
    alternatives = " or ".join(f"--rig {name}" for name, other in RIGS.items() if other is not rig)
    return fault(
        "scalings", "ranges of the converters", value, bound=f"those of a {rig.title}",
        remedy=f"{_CORRECT}, or give {alternatives}",
    )  # fmt: skip


def _settings(bench: Bench, scaling: Scaling) -> Iterator[Verdict]:
    rejected = [event for event in bench.begin.events if event.code == EventCode.SETTINGS_REJECTED]
    if rejected:
        yield fault(
            "settings-rejected", "stored settings", f"field {rejected[0].detail} is out of range",
            remedy="its program's settings are in force: write the EEPROM again",
        )  # fmt: skip
    parameters = bench.parameters
    if parameters is None:
        yield fault("settings", "settings", "not answered", remedy=_CORRECT)
        return
    problem = _problem(parameters, scaling, bench.rig)
    if problem:
        yield fault("settings", "settings", problem, remedy=_CORRECT)
    else:
        low, high = (1e3 * scaling.x_m(parameters.int(name)) for name in ("x_ref_min", "x_ref_max"))
        yield passed(
            "settings",
            "settings",
            f"x_ref {low:.2f} to {high:.2f} mm, u_c to {scaling.u_v(parameters.int('u_max')):.3g} V",
        )


def _problem(parameters: Message, scaling: Scaling, rig: RigNumbers) -> str:
    """Return what is wrong with the settings, or ""."""
    number = parameters.int
    low, high = (scaling.x_m(number(name)) for name in ("x_ref_min", "x_ref_max"))
    if not -0.1 * rig.travel_m <= min(low, high) < max(low, high) <= 1.1 * rig.travel_m:
        return f"references from {1e3 * low:.2f} to {1e3 * high:.2f} mm are not in the travel of {rig.travel_m * 1e3:g}"
    if not number("x_ref_min") <= number("x_0") <= number("x_ref_max"):
        return f"the operating point x_0 = {1e3 * scaling.x_m(number('x_0')):.2f} mm is not a possible reference"
    if not any(number(f"k{n}_mantissa") for n in range(1, 4)):
        return "all gains are 0"
    if scaling.u_v(number("u_max")) < rig.rest_input_v:
        return f"u_max = {scaling.u_v(number('u_max')):.2f} V does not lift the ball"
    return ""
