"""Plot measurement and twin from a log (PNG, SVG or PDF by the file's suffix).

The twin's topics are taken from the log if it contains them; otherwise, or with --model, the twin is run over the log.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import check_name
from protocol.errors import DataError, UsageError
from twin.commands import add_show, show
from twin.commands.twin import add_model_options, chosen_settings
from twin.model.parameters import SHIPPED, Model
from twin.settings.mirror import Settings

if TYPE_CHECKING:
    from twin.mirror.offline import BoardRun
    from twin.mirror.output import Output
    from twin.mirror.plots.traces import Traces

SUFFIXES = (".png", ".svg", ".pdf")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        "examples:\n"
        "  board51 plot run.mcap --show\n"
        "  board51 plot run.mcap --out run.png --board rig1 --from 2 --to 8\n"
        "  board51 plot run.mcap --out run.png --model identified.json\n"
        "  board51 plot run.mcap --out run.png --span 2:12=before --span 60:70=after    side by side"
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="MCAP log")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="picture file, overwritten (default: the log's name with .png, here)"
    )
    parser.add_argument("--board", help="board (default: the only one)")
    parser.add_argument("--from", dest="from_s", type=float, metavar="S", help="board time, s (default: coil on)")
    parser.add_argument("--to", dest="to_s", type=float, metavar="S", help="board time, s (default: coil off)")
    parser.add_argument(
        "--span",
        action="append",
        type=_span,
        metavar="FROM:TO[=LABEL]",
        help="board time, s; repeat it to see spans side by side (label: the model that ran)",
    )
    parser.add_argument("--json", action="store_true", help="print what was drawn as JSON")
    add_show(parser)
    add_model_options(parser)
    parser.set_defaults(model=None)


def _span(text: str) -> tuple[float, float, str]:
    times, _, label = text.partition("=")
    try:
        begin, end = map(float, times.split(":"))
    except ValueError:
        begin = end = math.nan
    if not (math.isfinite(begin + end) and begin < end):
        raise argparse.ArgumentTypeError(f"{text!r} is not FROM:TO[=LABEL] in seconds, FROM before TO")
    return begin, end, label


def run(args: argparse.Namespace) -> int:
    """Draw."""
    if args.span and (args.from_s is not None or args.to_s is not None):
        raise UsageError("--span and --from, --to exclude each other", remedy="Use --span alone")
    args.out = args.out or Path(f"{args.log.stem}.png")
    if args.out.suffix.lower() not in SUFFIXES:
        raise UsageError(f"--out {args.out}: unknown kind of picture", remedy=f"End it in {', '.join(SUFFIXES)}")
    if args.board:
        check_name(args.board, what="--board")
    supplied = args.model is not None
    args.model = args.model or SHIPPED[0]
    model, settings = Model.load(args.model), chosen_settings(args)

    traces = {} if supplied else _from_topics(args.log, args.board)
    source = "the twin that was logged"
    if not traces:
        traces, source = _from_run(args.log, args.board, model, settings), f"the model {args.model}"
    if len(traces) > 1:
        raise UsageError(f"{args.log} holds the boards {', '.join(sorted(traces))}", remedy="Choose one with --board")
    board, trace = next(iter(traces.items()))
    title = f"{board}, {args.log.name}: measured against {source}"
    try:
        if args.span:
            _draw_spans(args, board, trace, title, supplied=args.model if supplied else "")
        else:
            _draw(args, board, trace, title, model, settings)
    except OSError as error:
        raise DataError(f"{args.out}: cannot be written ({error.strerror})", remedy="Choose another --out") from error
    result = {
        "out": str(args.out),
        "board": board,
        "samples": len(trace.rows),
        "from_t_s": trace.rows[0][0],
        "to_t_s": trace.rows[-1][0],
        "twin": source,
    }
    print(json.dumps(result, indent=2) if args.json else f"{args.out}: {len(trace.rows)} samples of {board}, {source}")
    if args.show:
        show(args.out)
    return 0


def _draw(args: argparse.Namespace, board: str, trace: Traces, title: str, model: Model, settings: Settings) -> None:
    from twin.mirror.plots.traces import draw

    remedy = _times_of(trace)
    trace.crop(args.from_s, args.to_s)
    if not trace.rows:
        raise DataError(f"{args.log}: no samples between --from and --to", remedy=remedy)
    nis_on, error_on = _thresholds(args.log, board, trace, model, settings)
    draw(trace, args.out, nis_on=nis_on, error_on=error_on, title=title)


def _draw_spans(args: argparse.Namespace, board: str, trace: Traces, title: str, *, supplied: str) -> None:
    from twin.mirror.plots.spans import Column, draw_spans

    columns = []
    for begin, end, label in args.span:
        part = trace.part(begin, end)
        if len(part.rows) < 2:
            raise DataError(f"{args.log}: no samples in --span {begin:g}:{end:g}", remedy=_times_of(trace))
        if not label:
            ran = supplied or _model_at(args.log, board, end)
            label = f"twin of {ran}" if ran else f"from {begin:g} s"
        columns.append(Column(traces=part, label=label))
    draw_spans(columns, args.out, title=title)


def _times_of(trace: Traces) -> str:
    """Return the advice which times there are."""
    times_s = [row[0] for row in trace.rows]
    return f"Choose from {min(times_s):.1f} to {max(times_s):.1f} s, by the clock of {trace.board}"


def _model_at(path: Path, board: str, t_s: float) -> str:
    """Name of the twin's model at the end of a span, by the log; empty if the log does not contain it."""
    from protocol.log.reader import LogReader
    from twin.readers.log import entries, parse

    ran, now_s = "", -math.inf
    for entry in entries(LogReader(path), topics=("state", "twin/model"), board=board):
        if entry.topic == "state":
            now_s = parse(pb.State, entry, path).t_s
        elif now_s <= t_s:
            model = parse(pb.TwinModel, entry, path)
            ran = f"{model.name} ({model.sha256[:12]})"
    return ran


def _thresholds(path: Path, board: str, trace: Traces, model: Model, settings: Settings) -> tuple[float, float]:
    """Return the alarm thresholds (of the mean NIS; of the mean squared error of x at the median reference, or NaN)."""
    from protocol.log.reader import LogReader
    from twin.mirror.regime import Regime
    from twin.readers.log import entries, parse

    sample_time_s = _sample_time(trace)
    entry = next(entries(LogReader(path), topics=("parameters",), board=board), None)
    parameters = parse(pb.Parameters, entry, path) if entry else None
    regime = Regime(model, settings, sample_time_s=sample_time_s, parameters=parameters)
    references = sorted(row[2] for row in trace.rows if row[2] == row[2])
    if not references or regime.law is None:
        return regime.nis_on, float("nan")
    return regime.nis_on, regime.expectation(references[len(references) // 2]).on[0]


def _sample_time(trace: Traces) -> float:
    steps = sorted(b[0] - a[0] for a, b in zip(trace.rows, trace.rows[1:], strict=False) if b[0] > a[0])
    return steps[len(steps) // 2] if steps else 2e-3


def _from_run(path: Path, board: str | None, model: Model, settings: Settings) -> dict[str, Traces]:
    from twin.mirror.offline import run_log
    from twin.mirror.plots.traces import Traces

    traces: dict[str, Traces] = {}

    def take(run: BoardRun, state: pb.State, output: Output) -> None:
        trace = traces.setdefault(run.board, Traces(run.board))
        trace.add(state, output.state, output.divergence)
        trace.note(output.alarms, state.t_s)

    run_log(path, model, settings=settings, board=board, on_output=take)
    return traces


def _from_topics(path: Path, board: str | None) -> dict[str, Traces]:
    """Match samples and twin topics by (session, tick); empty if the log has no twin topics."""
    from protocol.log.reader import LogReader
    from twin.mirror.plots.traces import Traces
    from twin.readers.log import entries, parse

    kinds = {"state": pb.State, "twin/state": pb.TwinState, "twin/divergence": pb.Divergence, "twin/alarm": pb.Alarm}
    samples: dict[tuple[str, str], dict[tuple[int, int], Any]] = defaultdict(dict)  # by topic and board
    alarms: dict[str, list[pb.Alarm]] = defaultdict(list)
    for entry in entries(LogReader(path), topics=tuple(kinds), board=board):
        message: Any = parse(kinds[entry.topic], entry, path)
        if entry.topic == "twin/alarm":
            alarms[entry.board].append(message)
        else:
            samples[entry.topic, entry.board][message.session, message.tick] = message
    traces: dict[str, Traces] = {}
    for name in [name for topic, name in samples if topic == "state"]:
        states, twins, divergences = (samples[topic, name] for topic in ("state", "twin/state", "twin/divergence"))
        if not divergences:
            continue
        trace = traces[name] = Traces(name)
        for at, state in states.items():
            trace.add(state, twins.get(at), divergences.get(at))
        times = {at: state.t_s for at, state in states.items()}
        for alarm in alarms[name]:
            trace.note([alarm], times.get((alarm.session, alarm.tick), float("nan")))
    return traces
