"""Send one command to a board through its gateway, and say what became of it.

Exit code 0 if the board accepted it, 1 if it was refused or not delivered.
"""

from __future__ import annotations

import argparse
import getpass
import json
import math
import shlex

from google.protobuf.json_format import MessageToDict

from gateway.access.authorize import MAX_AGE_S
from gateway.client.connection import add_bus_arguments, open_bus, send
from protocol.bus import board51_pb2 as pb
from protocol.bus.identity import find_identity
from protocol.bus.topics import check_name
from protocol.errors import UsageError

_MODES = {"idle": pb.MODE_IDLE, "open-loop": pb.MODE_OPEN_LOOP, "closed-loop": pb.MODE_CLOSED_LOOP}
_SHAPES = {name.removeprefix("SHAPE_").lower(): name for name in pb.Shape.keys()}
_POLICIES = {"keep": 0, "coil-off": 1, "hold": 2}


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def _whole(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 0 to 2^32 - 1")
    return value


def _wait(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} is not a time to wait")
    return value


def _duration(text: str) -> float:
    """Seconds; 0, which is endless on the bus, only by its name."""
    if text == "endless":
        return 0.0
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} s is no duration; without end it is 'endless'")
    return value


def _unix_time(text: str) -> int:
    value = int(text)
    if not 0 < value < 2**64:
        raise argparse.ArgumentTypeError(f"{text} is no Unix time in ns")
    return value


def _text(text: str) -> str:
    if not text.isprintable():  # bytes of the command line that are not UTF-8, too
        raise argparse.ArgumentTypeError(f"{text!r} has characters that cannot be printed")
    return text


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    parser.add_argument(
        "--id", type=_text, default="", help="command id: a repetition has that of the first (default: a new one)"
    )
    parser.add_argument(
        "--issued",
        type=_unix_time,
        default=0,
        metavar="NS",
        help="when it was first sent, Unix time: with --id it is executed at most once, by a restarted gateway too",
    )
    parser.add_argument("--who", type=_text, default="", help="who sends it, for the log (default: the login name)")
    parser.add_argument("--timeout", type=_wait, default=5.0, metavar="S", help="wait this long for the answer (5 s)")
    parser.add_argument("--json", action="store_true", help="print the reply as JSON")


def configure(parser: argparse.ArgumentParser) -> None:
    """Board and one sub-command for each command of the bus."""
    parser.epilog = (
        "examples:\n  board51 send rig1 mode closed-loop\n  board51 send rig1 reference 0.0030\n"
        "  board51 send rig1 excite rectangle --on-reference --amplitude 0.001"
        " --offset 0.003 --period 2 --duration 20\n"
        "  board51 send rig1 stop --connect tls/10.0.0.5:7447 --identity identities/ana"
    )
    options = argparse.ArgumentParser(add_help=False)
    _add_options(options)
    parser.add_argument("board", help="name of the board")
    what = parser.add_subparsers(dest="what", required=True, metavar="COMMAND")
    what.add_parser("mode", parents=[options], help="idle, open-loop or closed-loop").add_argument(
        "mode", choices=_MODES
    )
    what.add_parser("reference", parents=[options], help="position to hold").add_argument(
        "x_ref", type=_number, metavar="METRES"
    )
    gains = what.add_parser("gains", parents=[options], help="control law, gains and operating point, SI (eq. 16-19)")
    gains.add_argument("gains", type=_number, nargs=4, metavar="K", help="LQI: k_i k_x k_v k_int; PID: k_p k_int k_d 0")
    gains.add_argument("--law", choices=("lqi", "pid"), default="lqi")
    gains.add_argument("--operating-point", type=_number, nargs=3, required=True, metavar=("I_A", "X_M", "U_V"))
    excite = what.add_parser(
        "excite", parents=[options], help="play a signal on u_c (open loop) or x_ref (closed loop)"
    )
    excite.add_argument("shape", choices=_SHAPES)
    excite.add_argument("--on-reference", action="store_true", help="x_ref in metres instead of u_c in volts")
    for name, unit in (("amplitude", "V|M"), ("period", "S"), ("period-end", "S")):
        excite.add_argument(f"--{name}", type=_number, default=0.0, metavar=unit)
    excite.add_argument("--offset", type=_number, metavar="V|M", help="absolute (default 0)")
    excite.add_argument(
        "--duration", type=_duration, metavar="S|endless", help="needed by all shapes but none; then it is the offset"
    )
    excite.add_argument("--seed", type=_whole, default=1)
    excite.epilog = (
        "`excite none` ends what is played, in either mode: the signal stays where it is. With --offset V in open loop"
        " u_c stays at that level instead; in closed loop `reference` moves the ball."
    )
    capture = what.add_parser("capture", parents=[options], help="record i_c at 25 kHz around a step of u_c")
    for name in ("u-from", "u-to"):
        capture.add_argument(f"--{name}", type=_number, required=True, metavar="V")
    capture.add_argument("--duration", type=_number, default=0.04, metavar="S", help="0.04 s")
    capture.add_argument("--pre", type=_number, default=0.004, metavar="S", help="before the step (0.004 s)")
    what.add_parser("stream", parents=[options], help="send every n-th tick").add_argument("divider", type=_whole)
    loss = what.add_parser("host-loss", parents=[options], help="what the board does without its host")
    loss.add_argument("policy", choices=_POLICIES)
    loss.add_argument("--after", type=_number, default=1.0, metavar="S", help="1 s")
    what.add_parser("mark", parents=[options], help="a remark at this moment, into every log").add_argument(
        "text", type=_text
    )
    seen = what.add_parser("acknowledge", parents=[options], help="somebody has seen an alarm; in every view and log")
    seen.add_argument("alarm", type=_text, help="its name, such as divergence-x")
    seen.add_argument("--comment", type=_text, default="", metavar="TEXT", help="why it may be so")
    what.add_parser("stop", parents=[options], help="coil off at once")
    what.add_parser("ping", parents=[options], help="sign of life")


def _login() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user need not have a name
        return "unknown"


def build(args: argparse.Namespace) -> pb.Command:
    """The bus command that the arguments describe.

    Raises:
        UsageError: an excitation without its end, or with a level that would count for nothing.
    """
    command = pb.Command(id=args.id, who=args.who or _login(), issued_ns=args.issued)
    match args.what:
        case "mode":
            command.set_mode.mode = _MODES[args.mode]
        case "reference":
            command.set_reference.x_ref_m = args.x_ref
        case "gains":
            i_0, x_0, u_0 = args.operating_point
            law = pb.LAW_LQI if args.law == "lqi" else pb.LAW_PID
            command.set_gains.CopyFrom(pb.SetGains(law=law, gains=args.gains, i_0_a=i_0, x_0_m=x_0, u_0_v=u_0))
        case "excite":
            if args.shape == "none" and args.on_reference and args.offset is not None:
                raise UsageError(
                    "An excitation of the reference that ends leaves it where it is: --offset counts for nothing",
                    remedy="Leave it out, and move the reference with `board51 send BOARD reference METRES`",
                )
            if args.shape != "none" and args.duration is None:
                raise UsageError(
                    f"The {args.shape} has no end",
                    remedy="Give --duration S, or --duration endless if it shall have none",
                )
            command.excite.CopyFrom(
                pb.Excite(
                    shape=_SHAPES[args.shape],
                    on_reference=args.on_reference,
                    amplitude=args.amplitude,
                    offset=args.offset,
                    period_s=args.period,
                    period_end_s=args.period_end,
                    seed=args.seed,
                    duration_s=args.duration or 0.0,
                )
            )
        case "capture":
            command.capture.CopyFrom(
                pb.Capture(u_from_v=args.u_from, u_to_v=args.u_to, duration_s=args.duration, pre_s=args.pre)
            )
        case "stream":
            command.set_stream.divider = args.divider
        case "host-loss":
            command.set_host_loss.CopyFrom(pb.SetHostLoss(policy=_POLICIES[args.policy], timeout_s=args.after))
        case "mark":
            command.mark.text = args.text
        case "acknowledge":
            command.acknowledge.CopyFrom(pb.Acknowledge(alarm=args.alarm, comment=args.comment))
        case "stop":
            command.stop.SetInParent()
        case _:
            command.ping.SetInParent()
    return command


def run(args: argparse.Namespace) -> int:
    """Send, print, 0 or 1."""
    check_name(args.board, what="board")
    identity = find_identity(args.identity)
    command = build(args)
    with open_bus(args.connect, identity) as session:
        reply = send(session, args.site, args.board, command, timeout_s=args.timeout, identity=identity)
    if args.json:
        print(
            json.dumps(
                MessageToDict(reply, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
            )
        )
    elif reply.accepted:
        print(f"accepted, in force from tick {reply.tick}" + (f" ({reply.text})" if reply.text else ""))
    else:
        print(f"refused by {reply.refused_by}: {reply.reason}: {reply.text}")
        if reply.refused_by == "link" and args.what != "stop":
            again = f"--id {shlex.quote(command.id)} --issued {command.issued_ns}"
            print(f"To repeat it without its being executed twice, within {MAX_AGE_S:g} s: {again}")
    return 0 if reply.accepted else 1
