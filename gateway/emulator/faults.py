"""Faults of the link and the board, by name, and their effect on the bytes.  Pure: the caller passes the time.

    NAME[=VALUE][@START[+LENGTH]][/EVERY][:OPTION]

Rule 1: times are seconds of the board since power-on, so that a run is reproducible at any speed.
Rule 2: all randomness comes from the seed; without an active fault, a direction passes its bytes unchanged.
Rule 3: a rate is a probability per byte and lasts from START for LENGTH (without them: always).  A timed fault begins
        at START and lasts VALUE seconds; with /EVERY it comes again.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from protocol.errors import UsageError

RATES = {
    "flip": "one bit of a byte is inverted",
    "lost": "a byte is lost",
    "duplicate": "a byte arrives twice",
    "insert": "a random byte arrives before it",
}
SPANS = {
    "stall": "no byte passes; all of them come in a burst afterwards",
    "disconnect": "the port is closed and opened again; option :renamed opens a pty under PATH-renamed",
    "baud": "wrong baud rate: every byte arrives as garbage",
}
OUTPUTS = {  # the first counts where both are active
    "deaf": "the converter of u_c confirms no write and keeps its output",
    "stuck": "the converter of u_c confirms every write and keeps its output: a shorted driver",
}
WIRING = {  # between plant and board; an option in brackets has a value
    "coil-open": "no wire to the coil: no current flows",
    "coil-reversed": "the coil's wires are swapped: it pushes a magnet down (but still pulls a steel ball)",
    "i-unplugged": "the pin of i_c is at the bottom of its converter",
    "x-unplugged": "the pin of x is at the bottom of its converter",
    "x-frozen": "the pin of x keeps its value",
    "x-inverted": "the pin of x is mirrored in the range of its converter",
}
CODES = {
    "i-bit": "bit N of the converter of i_c is stuck at 1",
    "x-bit": "bit N of the converter of x is stuck at 1",
    "i-noise": "noise on the pin of i_c, one sigma of N codes",
    "x-noise": "noise on the pin of x, one sigma of N codes",
}
CLOCK = {"crystal": "the board's clock runs at N times its rate"}
LASTING = RATES | WIRING | CODES | CLOCK  # from START for LENGTH; the others last for their VALUE
EVENTS = {
    "reset": "the board loses power for a moment",
    "watchdog": "the firmware hangs and the watchdog resets it 50 ms later",
    "overrun": "a control tick takes longer than T_s",
    "stack": "the end of the board's stack is overwritten",
}
_NAMES = LASTING | SPANS | OUTPUTS | EVENTS
HELP = "\n".join(
    [
        "faults (--fault NAME[=VALUE][@START[+LENGTH]][/EVERY][:OPTION], repeatable; times in seconds of the board):",
        *(f"  {name + '=P':<14} {description}, with probability P per byte" for name, description in RATES.items()),
        *(f"  {name + '=S':<14} {description}; lasts S s" for name, description in (SPANS | OUTPUTS).items()),
        *(f"  {name + '=N':<14} {description}" for name, description in (CODES | CLOCK).items()),
        *(f"  {name:<14} {description}" for name, description in (WIRING | EVENTS).items()),
        "  @START         begins then (default 0); @START+LENGTH ends a fault that has no duration after LENGTH s",
        "  /EVERY         comes again every EVERY s after START",
        "  :tx :rx        only bytes from the board, only bytes to it (default both ways)",
        "  e.g. flip=1e-4   lost=0.01@5+2   stall=0.5@10/30   disconnect=2@20:renamed   reset@60   insert=1e-3:tx",
    ]
)
_GRAMMAR = re.compile(
    r"(?P<name>[a-z-]+)(=(?P<value>[^@/:]+))?(@(?P<start>[^+/:]+)(\+(?P<length>[^/:]+))?)?(/(?P<every>[^:]+))?(:(?P<option>[a-z]+))?"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A fault.  `value` is a probability per byte, a duration in s, a number N, or 0 where there is none."""

    name: str
    value: float = 0.0
    start_s: float = 0.0
    length_s: float = math.inf
    every_s: float = math.inf
    option: str = ""

    def active(self, time_s: float) -> bool:
        """Return whether the fault, unless it is an event, is active at this time."""
        since = time_s - self.start_s
        if since < 0:
            return False
        if math.isfinite(self.every_s):
            since = math.fmod(since, self.every_s)
        return since < (self.length_s if self.name in LASTING else self.value)

    def happens(self, from_s: float, to_s: float) -> bool:
        """Return whether an event occurs within [from_s, to_s)."""
        if to_s <= self.start_s:
            return False
        if from_s <= self.start_s:
            return True
        if not math.isfinite(self.every_s):
            return False
        return math.ceil((from_s - self.start_s) / self.every_s) * self.every_s + self.start_s < to_s

    def shifted(self, time_s: float) -> Fault:
        """Return the same fault with its START counted from `time_s`."""
        return replace(self, start_s=self.start_s + time_s)


def parse(text: str) -> Fault:
    """Parse a fault as given to --fault.

    Raises:
        UsageError: the name is unknown, or a value is missing, superfluous, not a number or out of range.
    """
    match = _GRAMMAR.fullmatch(text.strip())
    if match is None:
        raise _error(text, "not of the form NAME[=VALUE][@START[+LENGTH]][/EVERY][:OPTION]")
    name, option = match["name"], match["option"] or ""
    if name not in _NAMES:
        raise _error(text, f"no fault is called {name}")
    bare = EVENTS | WIRING
    if (match["value"] is None) != (name in bare):
        raise _error(text, "takes no value" if name in bare else "needs a value")
    if match["length"] is not None and name not in LASTING:
        raise _error(text, "+LENGTH is not for this fault; its value is its duration")
    options = ("renamed",) if name == "disconnect" else ("tx", "rx") if name in RATES | SPANS else ()
    if option and option not in options:
        raise _error(text, f"has no option {option}")
    fault = Fault(
        name=name,
        value=_number(text, match["value"], 0.0),
        start_s=_number(text, match["start"], 0.0),
        length_s=_number(text, match["length"], math.inf),
        every_s=_number(text, match["every"], math.inf),
        option=option,
    )
    if name in RATES and fault.value > 1.0:
        raise _error(text, "a probability is at most 1")
    if name in ("i-bit", "x-bit") and fault.value not in range(16):
        raise _error(text, "a bit is a whole number from 0 to 15")
    if name == "crystal" and not 0.5 <= fault.value <= 2.0:
        raise _error(text, "a clock runs at 0.5 to 2 times its rate")
    if fault.every_s <= (fault.value if name in SPANS else 0.0):
        raise _error(text, "/EVERY must be longer than the fault itself")
    return fault


class FaultyLine:
    """A direction of the line (`tx` is from the board, `rx` to it), which may damage, delay or lose bytes."""

    def __init__(self, direction: str, seed: int) -> None:
        self._direction = direction
        self._random = random.Random(f"{direction}{seed}")
        self._held = bytearray()
        self.damaged = 0  # bytes flipped, lost, duplicated, inserted, garbled or discarded

    def convey(self, data: bytes, time_s: float, faults: Iterable[Fault]) -> bytes:
        """Return the bytes that arrive at `time_s` when `data` is sent."""
        active = [
            fault
            for fault in faults
            if fault.name in RATES | SPANS
            and (not fault.option or fault.option in (self._direction, "renamed"))
            and fault.active(time_s)
        ]
        if not active and not self._held:
            return data
        for fault in active:
            if fault.name not in ("stall", "disconnect"):
                data = b"".join(self._damage(byte, fault) for byte in data)
        if any(fault.name == "disconnect" for fault in active):
            self.damaged += len(self._held) + len(data)
            self._held.clear()
            return b""
        self._held += data
        if any(fault.name == "stall" for fault in active):
            return b""
        data = bytes(self._held)
        self._held.clear()
        return data

    def _damage(self, byte: int, fault: Fault) -> bytes:
        chance = self._random
        if fault.name == "baud":
            # A receiver at another rate samples the wrong bits: its bytes are unrelated to those sent, and often there
            # is none, because the stop bit is missing.
            self.damaged += 1
            return bytes((chance.randrange(256),)) if chance.random() < 0.7 else b""
        if chance.random() >= fault.value:
            return bytes((byte,))
        self.damaged += 1
        if fault.name == "flip":
            return bytes((byte ^ 1 << chance.randrange(8),))
        if fault.name == "lost":
            return b""
        if fault.name == "duplicate":
            return bytes((byte, byte))
        return bytes((chance.randrange(256), byte))


def _number(text: str, number: str | None, default: float) -> float:
    if number is None:
        return default
    try:
        value = float(number)
    except ValueError:
        raise _error(text, f"{number} is not a number") from None
    if not (math.isfinite(value) and value >= 0.0):
        raise _error(text, f"{number} must be finite and not negative")
    return value


def _error(text: str, problem: str) -> UsageError:
    return UsageError(f"Fault {text!r}: {problem}", remedy="See the list of faults in `board51 emulate --help`")
