"""Ask a board that was just written whether it runs the new program, and whether its coil is off.

avrdude's success says that the bytes are in the flash memory.  Whether the program starts, the converter answers and
no current flows is the board's to say.
"""

from __future__ import annotations

from gateway.board.scaling import scaling_of
from gateway.link.port import PortProblem, open_port
from gateway.selftest.connection import Connection, NoAnswerError
from gateway.selftest.wire import SerialWire
from protocol.errors import ServiceError
from protocol.wire.decoder import State
from protocol.wire.messages import COUNTS_MAX, Flag, Message

ANSWER_S = 8.0  # a boot loader of an Uno takes up to 2 s, and opening the port starts it again
_STATES = 50  # 0.1 s
_MOST_COUNTS = COUNTS_MAX // 50  # of i_c without an input: noise, and an offset of the sensor
_CUT = "Cut the supply of the coil, then look at the wiring"


def query_board(port: str, baud: int, build: bytes) -> str:
    """Return a line that says what the board answers, after avrdude has written it.

    `build` is what IDENTITY has to say of the program.

    Raises:
        ServiceError: another program answers, u_c is not 0, current flows, or a fault is active.
    """
    opened = open_port(port, baud)
    if isinstance(opened, PortProblem):
        return f"written and verified; whether the coil is off is not known: {opened.text}"
    board = Connection(SerialWire(opened))

    def states() -> list[State]:
        return [sample.state for sample in board.samples if sample.session == board.session.number]

    try:
        answers = board.open(ANSWER_S) and board.until(lambda: len(states()) >= _STATES, ANSWER_S)
    except NoAnswerError:  # it was pulled
        answers = False
    finally:
        opened.close()
    if not answers:
        return (
            f"written and verified, but the board has not answered at {baud} baud within {ANSWER_S:g} s: "
            "whether the coil is off is not known; check the fuses (clock) and the baud rate"
        )
    return _verdict(board.identities[-1][1], states()[-_STATES:], build)


def _verdict(identity: Message, states: list[State], build: bytes) -> str:
    if identity.bytes("build") != build:
        problem = f"Written and verified, but the board says build {_text(identity.bytes('build'))}, not {_text(build)}"
        raise ServiceError(problem, remedy="Look whether the port is that of the board that was written")
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
