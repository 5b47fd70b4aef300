"""Send one command to a board through its gateway, and print the outcome.

Exit code 0 if the board accepted it, 1 if it was refused or not delivered.
"""

# A STOP imports only what it needs (tests/system/test_stop_imports.py): each import is time with the coil on.
from __future__ import annotations

import argparse
import json
import math
import shlex
from pathlib import Path

from gateway.client import commands
from gateway.client.connection import add_bus_arguments
from gateway.client.rig import Rig
from protocol import units
from protocol.arguments import argument, number, quantity, whole_number
from protocol.bus import board51_pb2 as pb

_number = argument(number, math.isfinite, "is not a finite number")
_whole = argument(whole_number, lambda value: 0 <= value < 2**32, "is not a whole number from 0 to 2^32 - 1")
_wait = argument(_number, lambda value: value > 0, "is not a time to wait")
_time = argument(_number, lambda value: value > 0, "s is not a duration; give a positive one")
_seconds = argument(_number, lambda value: value > 0, "s is not a duration; write 'endless' for one without end")
_unix_time = argument(whole_number, lambda value: 0 < value < 2**64, "is not a Unix time in ns")

_ALARM_ACTS = {
    "acknowledge": "acknowledge an alarm, in every view and in the log",
    "shelve": "keep an alarm quiet for a time, even if it goes and comes back",
    "unshelve": "end the shelving of an alarm early; it is acknowledged then",
}


def _duration(text: str) -> float:
    """Return the seconds; inf for `endless`."""
    return math.inf if text == "endless" else _seconds(text)


def _text(text: str) -> str:
    if not text.isprintable():  # bytes of the command line that are not UTF-8, too
        raise argparse.ArgumentTypeError(f"{text!r} has characters that cannot be printed")
    return text


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_bus_arguments(parser)
    parser.add_argument(
        "--id", type=_text, default="", help="command id; a repetition uses the id of the first (default: a new one)"
    )
    parser.add_argument(
        "--issued", type=_unix_time, default=0, metavar="NS",
        help="when it was first sent, Unix time; with --id it is executed at most once, also by a restarted gateway",
    )  # fmt: skip
    parser.add_argument("--who", type=_text, default="", help="who sends it, for the log (default: the login name)")
    parser.add_argument("--timeout", type=_wait, default=5.0, metavar="S", help="wait this long for the answer (5 s)")
    parser.add_argument("--json", action="store_true", help="print the reply as JSON")


def _add_excite_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shape", choices=list(map(str, commands.Shape)))
    parser.add_argument("--on-reference", action="store_true", help="x_ref in metres instead of u_c in volts")
    parser.add_argument("--amplitude", default="0", metavar="V|M")
    for name in ("period", "period-end"):
        parser.add_argument(f"--{name}", type=_number, default=0.0, metavar="S")
    parser.add_argument("--offset", metavar="V|M", help="absolute (default 0)")
    parser.add_argument(
        "--duration", type=_duration, metavar="S|endless", help="length; needed for every shape except none"
    )
    parser.add_argument("--seed", type=_whole, default=1)
    parser.epilog = (
        "`excite none` ends the excitation in either mode, and the signal keeps its value.\n"
        "With --offset V in open loop u_c stays at that level instead; in closed loop `reference` moves the ball."
    )


def configure(parser: argparse.ArgumentParser) -> None:
    """Board and one sub-command for each command of the bus."""
    parser.epilog = (
        "examples:\n  board51 send rig1 mode closed-loop\n  board51 send rig1 reference 0.0030      or 3mm\n"
        "  board51 send rig1 excite rectangle --on-reference --amplitude 0.001"
        " --offset 0.003 --period 2 --duration 20\n"
        "  board51 send rig1 shelve divergence-x --for 600 --comment 'coil is cold'\n"
        "  board51 send rig1 stop --connect tls/10.0.0.5:7447 --identity identities/ana"
    )
    options = argparse.ArgumentParser(add_help=False)
    _add_options(options)
    parser.add_argument("board", help="name of the board")
    what = parser.add_subparsers(dest="what", required=True, metavar="COMMAND", prog=f"{parser.prog} BOARD")

    def add(name: str, purpose: str) -> argparse.ArgumentParser:
        return what.add_parser(name, parents=[options], help=purpose)

    add("mode", "idle, open-loop or closed-loop").add_argument("mode", choices=list(map(str, commands.Mode)))
    add("reference", "position to hold").add_argument("x_ref", type=quantity("x_ref"), metavar="METRES")
    gains = add("gains", "control law, gains and operating point, SI (eq. 16-19)")
    gains.add_argument("gains", type=_number, nargs=4, metavar="K", help="LQI: k_i k_x k_v k_int; PID: k_p k_int k_d 0")
    gains.add_argument("--law", choices=list(map(str, commands.Law)), default=str(commands.Law.LQI))
    gains.add_argument("--operating-point", nargs=3, required=True, metavar=("I_A", "X_M", "U_V"))
    _add_excite_options(add("excite", "play a signal on u_c (open loop) or x_ref (closed loop)"))
    capture = add("capture", "record i_c at 25 kHz around a step of u_c")
    for name in ("u-from", "u-to"):
        capture.add_argument(f"--{name}", type=quantity("u_c"), required=True, metavar="V")
    capture.add_argument("--duration", type=_number, default=0.04, metavar="S", help="length (0.04 s)")
    capture.add_argument("--pre", type=_number, default=0.004, metavar="S", help="time before the step (0.004 s)")
    add("stream", "send every n-th tick").add_argument("divider", type=_whole)
    loss = add("host-loss", "set what the board does without its host")
    loss.add_argument("policy", choices=list(map(str, commands.HostLoss)))
    loss.add_argument("--after", type=_number, default=1.0, metavar="S", help="time without the host (1 s)")
    add("mark", "write a remark into every log").add_argument("text", type=_text)
    for name, purpose in _ALARM_ACTS.items():
        alarm = add(name, purpose)
        alarm.add_argument("alarm", type=_text, help="its name, such as divergence-x")
        alarm.add_argument("--comment", type=_text, default="", metavar="TEXT", help="the reason")
        if name == "shelve":
            alarm.add_argument("--for", dest="for_s", type=_time, required=True, metavar="S", help="at most 24 h")
    plant = add("plant", "state the plant card: ball, travel, x_max, gravity")
    plant.add_argument("file", type=Path, metavar="FILE", help="TOML with the [plant] of the rig")
    plant.add_argument("--confirmed", action="store_true", help="confirm that unusual values are right")
    add("stop", "coil off at once")
    add("ping", "sign of life")


def build(args: argparse.Namespace) -> pb.Command:
    """The bus command that the arguments describe.

    Raises:
        UsageError: an excitation without a duration, or with a level that would have no effect; an invalid plant.
    """
    match args.what:
        case "mode":
            return commands.set_mode(args.mode)
        case "reference":
            return commands.set_reference(args.x_ref)
        case "gains":
            i_c_a, x_m, u_c_v = map(units.quantity, args.operating_point, ("i_c", "x", "u_c"))
            point = commands.OperatingPoint(i_c_a=i_c_a, x_m=x_m, u_c_v=u_c_v)
            return commands.set_gains(args.gains, point, law=args.law)
        case "excite":
            channel = "x_ref" if args.on_reference else "u_c"
            return commands.excite(
                args.shape, on_reference=args.on_reference, amplitude=units.quantity(args.amplitude, channel),
                offset=None if args.offset is None else units.quantity(args.offset, channel), period_s=args.period,
                period_end_s=args.period_end, seed=args.seed, duration_s=args.duration,
            )  # fmt: skip
        case "capture":
            return commands.capture(u_from_v=args.u_from, u_to_v=args.u_to, duration_s=args.duration, pre_s=args.pre)
        case "stream":
            return commands.set_stream(args.divider)
        case "host-loss":
            return commands.set_host_loss(args.policy, timeout_s=args.after)
        case "mark":
            return commands.mark(args.text)
        case "shelve":
            return commands.shelve(args.alarm, args.for_s, comment=args.comment)
        case "acknowledge" | "unshelve":
            return commands.acknowledge(args.alarm, comment=args.comment)
        case "plant":
            from protocol.campaign import load_stated_plant

            return commands.set_plant(load_stated_plant(args.file), confirmed=args.confirmed)
        case "stop":
            return commands.stop()
        case _:
            return commands.ping()


def run(args: argparse.Namespace) -> int:
    """Send the command and print the reply; return 0 if it was accepted, otherwise 1."""
    command = build(args)
    command.id, command.issued_ns = args.id, args.issued
    rig = Rig(
        args.board, connect=args.connect, site=args.site, identity=args.identity, who=args.who, timeout_s=args.timeout,
        stop_on_error=False,
    )  # fmt: skip
    with rig:
        reply = rig.send(command)
    if args.json:
        from google.protobuf.json_format import MessageToDict

        fields = MessageToDict(reply, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
        print(json.dumps(fields))
    elif reply.accepted:
        print(f"accepted, in force from tick {reply.tick}" + (f" ({reply.text})" if reply.text else ""))
    else:
        print(f"refused by {reply.refused_by}: {reply.reason}: {reply.text}")
        if reply.refused_by == "link" and args.what != "stop":
            from gateway.access.authorize import MAX_AGE_S

            again = f"--id {shlex.quote(command.id)} --issued {command.issued_ns}"
            print(f"To repeat it so that it is executed at most once, within {MAX_AGE_S:g} s: {again}")
    return 0 if reply.accepted else 1
