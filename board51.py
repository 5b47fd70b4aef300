"""The `board51` command: lists the sub-commands, imports the one that was asked for, decides nothing.

A sub-command is a module with `configure(parser)` and `run(args) -> exit code`.  Exit codes: 0 done, 1 the work says
no, 2 bad usage or bad input (one line on stderr: what, where, what to do), 70 a fault of ours.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

from protocol.arguments import Parser, nearest
from protocol.ending import end_is_ordered, is_panic, order_end, reword
from protocol.errors import Board51Error, missing_extra, single_line

DEBUG = "BOARD51_DEBUG"  # set it to see where an unexpected error came from
OUR_FAULT = 70  # exit code: EX_SOFTWARE of sysexits.h; systemd's Restart=on-failure and the gateway start it again

COMMANDS: dict[str, tuple[str, str]] = {
    "start": ("gateway.commands.start", "run gateway, twin and control room at once, on a real or an emulated board"),
    "demo": ("gateway.commands.demo", "fly an emulated board, measure, identify, diagnose, fly with the better model"),
    "emulate": ("gateway.commands.emulate", "emulate a board on a pty or TCP port"),
    "flash": ("gateway.commands.flash", "write the firmware into the flash memory of a board, with avrdude"),
    "selftest": ("gateway.commands.selftest", "test a board on its serial port; each line says what to do"),
    "gateway": ("gateway.commands.gateway", "connect boards with the bus, and log everything, as a daemon"),
    "twin": ("twin.commands.twin", "run the model in step with a live rig or a log"),
    "campaign": ("gateway.commands.campaign", "record the paper's experiments on a live board, as a campaign"),
    "identify": ("twin.commands.identify", "identify a model from the recordings of a campaign"),
    "design": ("twin.commands.design", "design a controller for the board from a model"),
    "export-model": ("twin.commands.export_model", "export a model as FMU, MATLAB, Python, LaTeX or Modelica"),
    "validate": ("twin.commands.validate", "compare a model with recordings: figures, numbers, a report"),
    "bode": ("twin.commands.bode", "compare a model with measured frequency responses: bands, margins, a verdict"),
    "predict": ("twin.commands.predict", "predict the position N samples ahead along a recording"),
    "compare": (
        "twin.commands.compare",
        "compare two models on one flight, two flights under one model, or models over time",
    ),
    "what-if": ("twin.commands.what_if", "predict a recorded flight under other gains or another reference"),
    "diagnose": ("twin.commands.diagnose", "find the physical causes of a model's errors, and extend the model"),
    "investigate": (
        "gateway.commands.investigate",
        "run campaign and diagnosis in turns on a board, until one cause is left",
    ),
    "hmi": ("gateway.commands.views.hmi", "serve the control room for a browser"),
    "security": ("gateway.commands.security", "make keys, certificates and users of a guarded bus"),
    "opcua": ("gateway.commands.views.opcua", "serve the rigs over OPC UA, for SCADA systems"),
    "foxglove": (
        "gateway.commands.views.foxglove",
        "show the rigs live in Foxglove; print layouts for it and for PlotJuggler",
    ),
    "router": ("gateway.commands.router", "run a standalone zenoh router"),
    "send": ("gateway.commands.send", "send one command to a board, through the gateway"),
    "watch": ("gateway.commands.watch", "print the messages on the bus"),
    "record": ("gateway.commands.logs.record", "log the bus to MCAP without a gateway"),
    "serve-log": ("gateway.commands.logs.serve_log", "serve the log of a site on the bus, for `fill` at another site"),
    "fill": ("gateway.commands.logs.fill", "fill the gaps of a recording from the log servers"),
    "merge": ("gateway.commands.logs.merge", "merge the parts of a folder into one log, each record once"),
    "import": ("gateway.commands.logs.import_", "convert CSV or MATLAB recordings to MCAP"),
    "export": ("gateway.commands.logs.export", "convert MCAP to CSV, MATLAB or Parquet"),
    "replay": ("gateway.commands.logs.replay", "replay a log onto the bus, or its bytes into a pty"),
    "recover": ("gateway.commands.logs.recover", "repair a broken log: save its intact messages"),
    "info": ("gateway.commands.logs.info", "print the contents of a log"),
    "logs": ("gateway.commands.logs.logs", "search many logs: which flights, when, on which model; archive them"),
    "plot": ("twin.commands.plot", "plot measured values against the twin, from a log"),
    "completion": ("gateway.commands.completion", "print a script that completes commands in bash or zsh"),
    "compile": ("twin.commands.compile", "compile the numerical kernels now instead of at their first use"),
    "bench": ("gateway.commands.bench", "run benchmarks, each against a baseline in the same run"),
}

PURPOSES = {  # the order of the help: what one wants to do, and the commands for it
    "fly": "start demo emulate send watch flash selftest",
    "measure and model": "campaign identify validate bode design twin predict what-if compare diagnose investigate"
    " export-model",
    "logs": "record info logs plot export import replay recover serve-log fill merge",
    "views": "hmi opcua foxglove",
    "operate": "gateway router security completion compile bench",
}
EXTRAS = {  # what a command needs beyond the core; what is not here runs without any extra
    **{name: "twin" for name, (module, _) in COMMANDS.items() if module.startswith("twin.")},
    **dict.fromkeys(("demo", "investigate"), "twin"),
    **dict.fromkeys(("import", "export"), "export"),
    "emulate": "emulator",
    **dict.fromkeys(("start", "bench"), "all"),
    "campaign": "campaign",
    "hmi": "web",
    "opcua": "opcua",
}
# A missing module of these packages is a fault of the installation, not an extra that is not installed.
PACKAGES = frozenset({"board51", "protocol", "gateway", "twin"})
SERVICES = frozenset(
    {"gateway", "twin", "hmi", "opcua", "foxglove", "router", "record", "serve-log", "fill"}
)  # run until they are told
# Those that say nothing while they work: on a terminal they give signs of life.
SILENT = frozenset(
    {"bode", "design", "export", "export-model", "import", "info", "plot", "predict", "recover", "what-if"}
)
FIRST_SIGN_S, NEXT_SIGN_S = 2.0, 10.0
PANIC_PATIENCE_S = 10.0


def _parser() -> Parser:
    """Return the parser of the command's name; the commands declare their own arguments."""
    listing = "\n\n".join(
        "\n".join([f"{purpose}:", *(f"  {name:<12} {COMMANDS[name][1]}" for name in names.split())])
        for purpose, names in PURPOSES.items()
    )
    parser = Parser(
        prog="board51",
        usage="board51 COMMAND ...",
        description="Gateway and digital twin of a magnetic levitation rig.",
        epilog=f"{listing}\n\nboard51 COMMAND --help explains one command, with an example.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and end")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    return parser


def _version() -> str:
    """Return the version that is installed, or that of the checkout if nothing is."""
    from importlib.metadata import PackageNotFoundError, version  # slow: not at each start

    try:
        return version("board51")
    except PackageNotFoundError:
        import tomllib
        from pathlib import Path

        text = (Path(__file__).parent / "pyproject.toml").read_text(encoding="utf-8")
        return f"{tomllib.loads(text)['project']['version']} (a checkout, not installed)"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; the entry point of the `board51` script."""
    if sys.platform == "win32":  # a pipe there may lack a letter
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(errors="replace")
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:2], "--help"]
    parser = _parser()
    words = parser.parse_args(arguments[:1])
    if words.version:
        print(f"board51 {_version()}")
        return 0
    chosen = words.command
    if chosen is None:
        parser.print_help()
        return 0
    if chosen not in COMMANDS:
        parser.error(f"there is no command {chosen!r}{nearest(chosen, COMMANDS)}")

    try:
        module = importlib.import_module(COMMANDS[chosen][0])
        command = Parser(prog=f"board51 {chosen}", description=module.__doc__)
        module.configure(command)
        with _hang_up_ends_in_good_order(), _signs_of_life(chosen):
            if chosen in SERVICES:
                return _ending_at_a_panic(module.run, command.parse_args(arguments[1:]))
            return int(module.run(command.parse_args(arguments[1:])))
    except Board51Error as error:
        return _report(chosen, error)
    except ModuleNotFoundError as error:
        library = (error.name or "board51").partition(".")[0]
        if chosen not in EXTRAS or library in PACKAGES:
            return _our_fault(chosen, error)
        return _report(chosen, missing_extra(EXTRAS[chosen], library))
    except BrokenPipeError:  # `board51 watch | head`
        return 0
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        return _our_fault(chosen, error)


def _report(command: str, error: Board51Error) -> int:
    """Write the error to stderr in one line, and return its exit code."""
    print(f"board51 {command}: {error}", file=sys.stderr)
    return error.exit_code


def _our_fault(command: str, error: Exception) -> int:
    """Report a fault of board51 in one line, or with its whole trace where DEBUG is set; return the exit code.

    It mends nothing: what a user can cause has an error of its own.  But whoever runs a plant needs one line to pass
    on, and a supervisor an exit code.
    """
    if os.environ.get(DEBUG):
        raise error
    what = single_line(f"{type(error).__name__}: {error}", 300)
    print(
        f"board51 {command}: a fault of board51 ({what}). Report it with the command; {DEBUG}=1 shows where.",
        file=sys.stderr,
    )
    return OUR_FAULT


def _ending_at_a_panic(run: Callable[[argparse.Namespace], int], args: argparse.Namespace) -> int:
    """Run; after a panic in a thread of zenoh's end as SIGTERM does, with an exit code that has it started again."""
    if threading.current_thread() is not threading.main_thread():
        return int(run(args))
    real = os.dup(2)
    reading, writing = os.pipe()
    os.dup2(writing, 2)
    os.close(writing)
    panicked = threading.Event()

    def forward() -> None:
        with os.fdopen(reading, "rb") as lines:
            for line in lines:
                panic = is_panic(line)
                with suppress(OSError):  # a terminal that is gone
                    os.write(real, reword(line) if panic else line)
                # A panic after the order to end is a line and no failure: `systemctl stop` must not leave "failed".
                if panic and not end_is_ordered() and not panicked.is_set():
                    panicked.set()
                    threading.Thread(target=give_up, daemon=True).start()
                    order_end()

    def give_up() -> None:
        time.sleep(PANIC_PATIENCE_S)
        os._exit(OUR_FAULT)  # what hangs at a lock of the dead thread's does not end by itself

    thread = threading.Thread(target=forward, name="stderr", daemon=True)
    thread.start()
    try:
        code = int(run(args))
    finally:
        sys.stderr.flush()
        os.dup2(real, 2)  # closes the pipe, if no child holds it
        thread.join(1.0)
        os.close(real)
    return OUR_FAULT if panicked.is_set() else code


@contextmanager
def _signs_of_life(command: str) -> Iterator[None]:
    """Print every few seconds that a command still works, if it prints nothing itself and stderr is a terminal."""
    ended, began_s = threading.Event(), time.monotonic()

    def tell() -> None:
        wait_s = FIRST_SIGN_S
        while not ended.wait(wait_s):
            print(f"[{time.monotonic() - began_s:5.1f} s] board51 {command} is working", file=sys.stderr, flush=True)
            wait_s = NEXT_SIGN_S

    if command in SILENT and sys.stderr.isatty():
        threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


@contextmanager
def _hang_up_ends_in_good_order() -> Iterator[None]:
    """A closed terminal (an ssh connection that ends) is SIGTERM: logs are closed, a campaign parks its ball.

    Further output is discarded: writing to a terminal that is gone raises, in the middle of that.  Under
    nohup the signal stays ignored.
    """
    terminals = [number for number in (1, 2) if os.isatty(number)]

    def hung_up(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # the shell and the terminal may both send it
        for terminal in terminals:
            os.dup2(os.open(os.devnull, os.O_WRONLY), terminal)
        os.kill(os.getpid(), signal.SIGTERM)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if hasattr(signal, "SIGBREAK"):  # Windows: Ctrl-Break is Ctrl-C, also for those that our own commands start
        signal.signal(signal.SIGBREAK, lambda *_: signal.raise_signal(signal.SIGINT))
    if not hasattr(signal, "SIGHUP") or signal.getsignal(signal.SIGHUP) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGHUP, hung_up)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
