"""Run the twin over a log: one mirror per board, a summary, and optionally a new log with the twin's topics.

The figures of the summary are of samples in step; a figure that needs a full window is that of the last one.

Rule: the given model is used from end to end.  The models that a live twin used when the log was made are listed but
      not used.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from protocol.errors import DataError
from protocol.log.reader import LogReader, RawLogRecord
from twin.mirror.bus.handover import believe
from twin.mirror.mirror import Mirror
from twin.mirror.output import Output
from twin.model.parameters import Model
from twin.readers.log import TwinLog, entries, parse
from twin.settings.mirror import Settings

SIGNALS = ("x_m", "i_c_a", "u_c_v")


@dataclass(slots=True, kw_only=True)
class BoardRun:
    """The result for one board."""

    site: str
    board: str
    mirror: Mirror
    samples: int = 0
    first_t_s: float = math.nan
    last_t_s: float = math.nan
    alarms: list[pb.Alarm] = field(default_factory=list)
    parameters_count: int = 0
    models_logged: list[pb.TwinModel] = field(default_factory=list)  # what a live twin ran on, one entry per change

    def add_model(self, message: pb.TwinModel) -> None:
        """Take a live twin's message about its model; repetitions, which differ in their time, have no effect."""
        message.ClearField("host_time_ns")
        if not self.models_logged or self.models_logged[-1] != message:
            self.models_logged.append(message)

    def add(self, state: pb.State) -> Output | None:
        """Take a sample; None if it repeats the previous tick."""
        self.samples += 1
        self.last_t_s = state.t_s
        if self.samples == 1:
            self.first_t_s = state.t_s
        output = self.mirror.handle(state)
        if output is not None:
            self.alarms += output.alarms
        return output

    def summary(self) -> dict[str, Any]:
        """Return the figures for a person and for --json; a figure that does not exist is None."""

        def ratio(total: float, count: float) -> float | None:
            return total / count if count else None

        def root(total: float, count: float) -> float | None:
            return math.sqrt(total / count) if count else None

        counters = self.mirror.counters
        *of_signals, of_innovations = self.mirror.comparison.totals.tolist()
        errors = dict(zip(SIGNALS, of_signals, strict=True))
        innovations, x_squares, i_squares, nis = of_innovations
        return {
            "site": self.site,
            "board": self.board,
            "samples": self.samples,
            "from_t_s": self.first_t_s,
            "to_t_s": self.last_t_s,
            "in_step": counters["samples_in-step"],
            "settling": counters["samples_settling"],
            "out_of_step": counters["samples_out-of-step"],
            "why_out_of_step": _counts(counters, "out_of_step:"),
            "starts": counters["starts"],
            "bridged_ticks": counters["bridged_ticks"],
            "duplicates": counters["duplicates"],
            "missing": _counts(counters, "missing_"),
            "parameters_seen": self.parameters_count,
            "models_logged": [
                _fields(model, "name", "sha256", "session", "since_tick", "who") for model in self.models_logged
            ],
            "rmse": {name: root(squares, count) for name, (count, _, squares, _) in errors.items()},
            "bias": {name: ratio(total, count) for name, (count, total, _, _) in errors.items()},
            "innovations": int(innovations),
            "innovation_rmse": {
                "x_m": root(x_squares, innovations),
                "i_c_a": root(i_squares, innovations),
            },
            "nis_mean": ratio(nis, innovations),
            "alarms": [
                _fields(alarm, "tick", "name", "active", "value", "threshold_on", "text") for alarm in self.alarms
            ],
        }


def run_log(
    path: Path,
    model: Model,
    *,
    settings: Settings | None = None,
    board: str | None = None,
    out: Path | None = None,
    on_output: Callable[[BoardRun, pb.State, Output], None] | None = None,
) -> tuple[list[BoardRun], bool]:
    """Run the twin over `path`; returns (one run per board, whether the log was closed properly).

    Args:
        path: MCAP log with state and parameters.
        model: what the twin believes.
        settings: window, false-alarm rate, longest bridge.
        board: only this one.
        out: write state, parameters and the twin's topics there; must not exist.
        on_output: called with every output.

    Raises:
        DataError: the log is unreadable or holds no samples (of that board).
    """
    runs: dict[tuple[str, str], BoardRun] = {}
    reader = LogReader(path)
    belief = believe(model)
    with TwinLog(out) if out else nullcontext() as log:
        for entry in entries(reader, topics=("state", "parameters", "twin/model"), board=board):
            run = runs.get((entry.site, entry.board))
            if run is None:
                # One for each board: sessions, ticks and control laws of two boards have nothing in common.
                run = BoardRun(site=entry.site, board=entry.board, mirror=Mirror(model, settings))
                runs[entry.site, entry.board] = run
            if entry.topic == "twin/model":
                run.add_model(parse(pb.TwinModel, entry, path))
            elif entry.topic == "parameters":
                run.parameters_count += 1
                run.mirror.parameters(parse(pb.Parameters, entry, path))
                _write(log, entry, entry.topic, entry.data, pb.Parameters)
            else:
                state = parse(pb.State, entry, path)
                if not run.samples:
                    used = belief.message(session=state.session, since_tick=state.tick, host_time_ns=state.host_time_ns)
                    _write(log, entry, "twin/model", used, pb.TwinModel)
                output = run.add(state)
                _write(log, entry, "state", entry.data, pb.State)
                if output is not None and on_output:
                    on_output(run, state, output)
                if output is not None and log:
                    _write_output(log, entry, output)
    analysed = [run for run in runs.values() if run.samples]
    if not analysed:
        raise DataError(
            f"{path}: no samples" + (f" of board {board!r}" if board else ""),
            remedy=f"Boards in this log: {', '.join(sorted(reader.boards)) or 'none'}",
        )
    return analysed, reader.finished


def _write(log: TwinLog | None, entry: RawLogRecord, topic: str, data: bytes | Message, kind: type[Message]) -> None:
    if log:
        log.write(key(entry.site, entry.board, topic), data, message_type=kind, log_time_ns=entry.time_ns)


def _write_output(log: TwinLog, entry: RawLogRecord, output: Output) -> None:
    if output.state is not None:
        _write(log, entry, "twin/state", output.state, pb.TwinState)
    _write(log, entry, "twin/divergence", output.divergence, pb.Divergence)
    for alarm in output.alarms:
        _write(log, entry, "twin/alarm", alarm, pb.Alarm)


def _counts(counters: Counter[str], prefix: str) -> dict[str, int]:
    """Return the counts of one kind, by what follows the prefix of their names."""
    return {name.removeprefix(prefix): n for name, n in sorted(counters.items()) if name.startswith(prefix)}


def _fields(message: Message, *names: str) -> dict[str, Any]:
    return {name: getattr(message, name) for name in names}
