"""Send one command to a board through its gateway, and say what became of it.

Exit code 0 if the board accepted it, 1 if it was refused or not delivered.
"""

from __future__ import annotations

import argparse
import getpass
import json
import math

from google.protobuf.json_format import MessageToDict

from gateway.client import add_bus_arguments, open_bus, send
from protocol.bus import board51_pb2 as pb
from protocol.bus.identity import find_identity
from protocol.bus.topics import check_name

_MODES = {"idle": pb.MODE_IDLE, "open-loop": pb.MODE_OPEN_LOOP, "closed-loop": pb.MODE_CLOSED_LOOP}
_SHAPES = {name.removeprefix("SHAPE_").lower(): name for name in pb.Shape.keys()}
_POLICIES = {"keep": 0, "coil-off": 1, "hold": 2}


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    parser.add_argument(
        "--id", default="", help="command id: the same id is executed at most once (default: a new one)"
    )
    parser.add_argument("--who", default="", help="who sends it, for the log (default: the login name)")
    parser.add_argument("--timeout", type=_number, default=5.0, metavar="S", help="wait this long for the answer (5 s)")
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
    for name, unit in (
        ("amplitude", "V|M"),
        ("offset", "V|M"),
        ("period", "S"),
        ("period-end", "S"),
        ("duration", "S"),
    ):
        excite.add_argument(f"--{name}", type=_number, default=0.0, metavar=unit)
    excite.add_argument("--seed", type=int, default=1)
    capture = what.add_parser("capture", parents=[options], help="record i_c at 25 kHz around a step of u_c")
    for name in ("u-from", "u-to"):
        capture.add_argument(f"--{name}", type=_number, required=True, metavar="V")
    capture.add_argument("--duration", type=_number, default=0.04, metavar="S", help="0.04 s")
    capture.add_argument("--pre", type=_number, default=0.004, metavar="S", help="before the step (0.004 s)")
    what.add_parser("stream", parents=[options], help="send every n-th tick").add_argument("divider", type=int)
    loss = what.add_parser("host-loss", parents=[options], help="what the board does without its host")
    loss.add_argument("policy", choices=_POLICIES)
    loss.add_argument("--after", type=_number, default=1.0, metavar="S", help="1 s")
    what.add_parser("mark", parents=[options], help="a remark at this moment, into every log").add_argument("text")
    seen = what.add_parser("acknowledge", parents=[options], help="somebody has seen an alarm; in every view and log")
    seen.add_argument("alarm", help="its name, such as divergence-x")
    seen.add_argument("--comment", default="", metavar="TEXT", help="why it may be so")
    what.add_parser("stop", parents=[options], help="coil off at once")
    what.add_parser("ping", parents=[options], help="sign of life")


def _login() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user need not have a name
        return "unknown"


def build(args: argparse.Namespace) -> pb.Command:
    """The bus command that the arguments describe."""
    command = pb.Command(id=args.id, who=args.who or _login())
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
            command.excite.CopyFrom(
                pb.Excite(
                    shape=_SHAPES[args.shape],
                    on_reference=args.on_reference,
                    amplitude=args.amplitude,
                    offset=args.offset,
                    period_s=args.period,
                    period_end_s=args.period_end,
                    seed=args.seed,
                    duration_s=args.duration,
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
    with open_bus(args.connect, identity) as session:
        reply = send(session, args.site, args.board, build(args), timeout_s=args.timeout, identity=identity)
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
    return 0 if reply.accepted else 1
