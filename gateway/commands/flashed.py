"""Ask a board that was just written whether it runs the new program, and whether its coil is off.

avrdude's success says that the bytes are in the flash memory.  Whether the program starts, the converter answers and
no current flows is the board's to say.
"""

from __future__ import annotations

import select
import time
from dataclasses import dataclass, field

from gateway.board.scaling import scaling_of
from gateway.link.port import Port, PortProblem, open_port
from protocol.errors import ServiceError
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import COUNTS_MAX, Flag, Message

ANSWER_S = 8.0  # a boot loader of an Uno takes up to 2 s, and opening the port starts it again
_REPEAT_S = 0.25
_STATES = 50  # 0.1 s
_SESSION = 0xF1A5
_MOST_COUNTS = COUNTS_MAX // 50  # of i_c without an input: noise, and an offset of the sensor
_CUT = "Cut the supply of the coil, then look at the wiring"


@dataclass
class _Answer:
    """The frames of the board so far."""

    identity: Message | None = None
    states: list[State] = field(default_factory=list)  # since the identity


def query_board(port: str, baud: int, build: bytes) -> str:
    """Return a line that says what the board answers, after avrdude has written it.

    Args:
        port: Serial device.
        baud: Of the firmware.
        build: What IDENTITY has to say of the program.

    Raises:
        ServiceError: another program answers, u_c is not 0, current flows, or a fault is active.
    """
    opened = open_port(port, baud)
    if isinstance(opened, PortProblem):
        return f"written and verified; whether the coil is off is not known: {opened.text}"
    try:
        answer = _listen(opened)
    finally:
        opened.close()
    if answer.identity is None or len(answer.states) < _STATES:
        return (
            f"written and verified, but the board has not answered at {baud} baud within {ANSWER_S:g} s: "
            "whether the coil is off is not known; check the fuses (clock) and the baud rate"
        )
    return _verdict(answer.identity, answer.states[-_STATES:], build)


def _listen(port: Port) -> _Answer:
    answer, decoder, number = _Answer(), StreamDecoder(), 0
    end, sent_s = time.monotonic() + ANSWER_S, 0.0
    while len(answer.states) < _STATES and (now := time.monotonic()) < end:
        if answer.identity is None and now - sent_s >= _REPEAT_S:
            number, sent_s = number % 255 + 1, now
            body = encode_body("HELLO", id=number, session=_SESSION, version_min=1, version_max=1)
            port.write(encode_frame(body))
        if not select.select([port.fd], [], [], _REPEAT_S)[0]:
            continue  # a tty without bytes reads as one that was pulled
        data = port.read()
        if data == b"":
            break  # it was pulled
        for event in decoder.feed(data or b""):
            if isinstance(event, Message) and event.name == "IDENTITY":
                answer.identity, answer.states = event, []
            elif isinstance(event, State) and answer.identity is not None:
                answer.states.append(event)
    return answer


def _verdict(identity: Message, states: list[State], build: bytes) -> str:
    if identity.bytes("build") != build:
        raise ServiceError(
            f"Written and verified, but the board says build {_text(identity.bytes('build'))}, not {_text(build)}",
            remedy="Look whether the port is that of the board that was written",
        )
    scaling = scaling_of(identity)
    if isinstance(scaling, str):
        raise ServiceError(f"Written and verified, but the board's scalings are not usable: {scaling}", remedy=_CUT)
    u_c, i_c = max(state.u_c for state in states), round(sum(state.i_c for state in states) / len(states))
    readings = f"u_c {scaling.u_v(u_c):.2f} V, i_c {1e3 * scaling.i_a(i_c):.1f} mA"
    if states[-1].flags & Flag.FAULT:
        raise ServiceError(f"Written and verified, but the board reports a fault, {readings}", remedy=_CUT)
    if u_c or i_c > _MOST_COUNTS:
        raise ServiceError(f"Written and verified, but THE COIL MAY BE ON: {readings}", remedy=_CUT)
    return f"written and verified; build {_text(build)} answers: {readings}, the coil is off"


def _text(build: bytes) -> str:
    return build.decode("ascii", "replace").strip()
