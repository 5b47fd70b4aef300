"""Runs checks in their order, and leaves the coil off at each end.

Rule 1: a check that cannot go on ends with a verdict; the ones after it run.
Rule 2: an event that the board reports by itself (a restart, a fault) is a fault of the check in which it first comes.
Rule 3: after a fault that makes the coil unsafe (`UNSAFE`) no check lets current flow.
Rule 4: at the end, after an error and after Ctrl-C, STOP is sent, and u_c must be seen to be 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from gateway.selftest.bench import Bench, FaultFoundError, NotReadyError
from gateway.selftest.checks.link import no_answer
from gateway.selftest.checks.load import OVERRUN_REMEDY
from gateway.selftest.connection import BOOT_S, NoAnswerError, RefusedError
from gateway.selftest.table import Check
from gateway.selftest.verdict import Result, Verdict, fault, passed, skipped, warning
from protocol.wire.messages import FAULT_EVENTS, RESETS, EventCode

_REPORTS = "reported-"
_REPORTED = FAULT_EVENTS - RESETS
UNSAFE = frozenset({  # faults after which no current may flow
    "scalings", "input-at-zero", "stop", "stop-unanswered", "host-loss", "reset", "reported-output-fault",
    "reported-uncommanded-current", "reported-over-current",
})  # fmt: skip
_STOP_REMEDY = "a STOP may not reach the board: look at its RX, keep a hand on the plug of the coil"
_REMEDIES = {
    EventCode.OUTPUT_FAULT: "CUT THE SUPPLY OF THE COIL: the input converter confirms no write",
    EventCode.UNCOMMANDED_CURRENT: "CUT THE SUPPLY OF THE COIL: current flows at u_c = 0, the driver is shorted",
    EventCode.OVER_CURRENT: "i_c is at the top of its converter: look at its amplifier, and for a short circuit",
    EventCode.STACK_FAULT: "the firmware has used more stack than it has: report it; a reset ends the fault",
    EventCode.SENSOR_FAULT: "x is at an end of its converter: look at the sensor and its plug",
}


def run_checks(bench: Bench, checks: Sequence[Check]) -> Iterator[Verdict]:
    """Call the board, run the checks, and yield their verdicts as they are found."""
    dead = ""
    try:
        bench.connect()
    except (NoAnswerError, RefusedError) as error:
        yield replace(fault("start", "the first commands", error.problem, remedy=error.remedy), check="start")
    if bench.begin.identity is None:
        yield replace(no_answer(bench), check="start")
        dead = "the board does not answer"
    for check in checks:
        reason = dead
        if check.current and not dead and (unsafe := bench.faults & UNSAFE):
            reason = f"no current flows before this is right: {', '.join(sorted(unsafe))}"
        if reason:
            yield replace(skipped(check.name, check.summary, reason), check=check.name)
            continue
        for verdict in _run_check(bench, check):
            if verdict.result == Result.FAULT:
                bench.faults.add(verdict.name)
            yield replace(verdict, check=check.name)
        for verdict in _recover(bench):
            dead = verdict.value if verdict.name == "lost-board" else dead
            if verdict.name not in bench.faults:
                bench.faults.add(verdict.name)
                yield replace(verdict, check=check.name)


def _run_check(bench: Bench, check: Check) -> Iterator[Verdict]:
    """Yield the verdicts of a check, and what the board reports meanwhile; the latter explains why a check ends."""
    events, restarts, expected = len(bench.line.events), bench.line.restarts, bench.expected_resets
    losses = bench.expected_host_losses
    end: Verdict | None = None
    try:
        yield from check.run(bench)
    except NotReadyError as reason:
        end = skipped(check.name, check.summary, str(reason))
    except FaultFoundError as error:
        end = error.verdict
    except (NoAnswerError, RefusedError) as error:
        name = "refused" if isinstance(error, RefusedError) else "no-answer"
        end = fault(name, "the check ends:", error.problem, remedy=error.remedy[:1].lower() + error.remedy[1:])
    reports_of_resets = sum(event.code in RESETS for event in bench.line.events[events:])
    unexpected = max(bench.line.restarts - restarts, reports_of_resets) - (bench.expected_resets - expected)
    reports = list(_reported(bench, events, unexpected))
    host_losses = sum(event.code == EventCode.HOST_LOST for event in bench.line.events[events:])
    if host_losses > bench.expected_host_losses - losses:
        yield warning(
            "host-lost", "the board reports", "HOST_LOST", remedy="the line or this computer stalls for 0.5 s"
        )
    yield from (verdict for verdict in reports if verdict.name not in bench.faults)
    known = {verdict.name for verdict in reports} or {name for name in bench.faults if name.startswith(_REPORTS)}
    if end is not None and end.name == "refused" and known:
        end = skipped(check.name, check.summary, f"the board is in a fault, see {min(known)}")
    elif end is not None and end.name == "no-answer" and reports:
        end = skipped(check.name, check.summary, f"the board restarted, see {reports[0].name}")
    if end is not None:
        yield end


def switch_off(bench: Bench) -> Verdict:
    """Send STOP, and say what u_c and i_c are then."""
    name, what, remedy = "coil-off", "the coil at the end", "CUT THE SUPPLY OF THE COIL"
    is_off = bench.line.switch_off()  # a board that we do not hear may hear us
    if not bench.line.identities:
        verdict = skipped(name, what, "the board does not answer")
    elif not is_off:
        verdict = fault(name, what, "NOT KNOWN TO BE OFF", remedy=remedy)
    else:
        try:
            i_a = bench.scaling.i_a(bench.line.samples[-1].state.i_c)
            verdict = passed(name, f"{what}: off,", f"u_c 0 V, i_c {1e3 * i_a:.2g} mA")
            if i_a > bench.rig.no_current_a:
                verdict = fault(name, what, f"u_c 0, but i_c {i_a:.3g} A", remedy=remedy)
        except NotReadyError:
            verdict = passed(name, what, "u_c 0")
    return replace(verdict, check="end")


def _reported(bench: Bench, first: int, unexpected: int) -> Iterator[Verdict]:
    """Yield what the board reported by itself."""
    events = bench.line.events[first:]
    if unexpected > 0:  # by number, not by cause: a boot loader may hide that a reset was commanded
        codes = {event.code for event in events if event.code in RESETS - {EventCode.RESET_COMMANDED}}
        causes = ", ".join(sorted(code.name for code in codes)) or "no event said why"
        yield fault(
            "unexpected-reset", "restarts that nobody ordered", f"{unexpected}, {causes}", bound="0",
            remedy="look at the supply under load, the brown-out level, the reset line and the watchdog",
        )  # fmt: skip
    if any(event.code == EventCode.OVERRUN for event in events):
        yield fault("overruns", "the board reports", "OVERRUN", remedy=OVERRUN_REMEDY)
    for code in sorted({event.code for event in events} & _REPORTED):
        name = code.name.lower().replace("_", "-")
        yield fault(f"{_REPORTS}{name}", "the board reports", code.name, remedy=_REMEDIES[code])


def _recover(bench: Bench) -> Iterator[Verdict]:
    """Let the coil be off and the session open before the next check; yield why there cannot be one."""
    try:
        if not bench.line.until(lambda: bench.line.session.is_open, BOOT_S):
            remedy = "look at its supply and at the line to it"
            yield fault("lost-board", "after the check", "the board does not answer any more", remedy=remedy)
        elif bench.line.stop() is None:
            yield fault("stop-unanswered", "STOP after the check", "has no ACK within 1 s", remedy=_STOP_REMEDY)
    except NoAnswerError as error:
        yield fault("lost-board", "after the check", error.problem, remedy="look at the plug and at dmesg, and repeat")
