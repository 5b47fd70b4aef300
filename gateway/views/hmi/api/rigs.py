"""The answers about rigs, from what the bus says of them: values of the types in shapes.py."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import Any

from pydantic import TypeAdapter

from gateway.board.reference import reference_range
from gateway.views.board_feed import BoardFeed
from gateway.views.hmi import snapshot
from gateway.views.hmi.api import shapes
from gateway.views.hmi.problems import remedy_of, sentence
from protocol.bus import board51_pb2 as pb

_STATES: TypeAdapter[Any] = TypeAdapter(shapes.States)
Table = dict[str, Any]
_MODES = {mode: word.replace(" ", "-") for mode, word in snapshot.MODES.items()}


def _measured(name: str) -> Callable[[pb.State], float | None]:
    def value_of(message: pb.State) -> float | None:
        value: float = getattr(message, name)
        return value if message.HasField(name) and math.isfinite(value) else None

    return value_of


# A minute has 30 000 samples, so columns are made one after the other, without a row in between.
_VALUES: dict[str, Callable[[pb.State], Any]] = {
    "t_s": attrgetter("t_s"),
    "tick": attrgetter("tick"),
    "session": attrgetter("session"),
    "host_time_s": lambda message: message.host_time_ns / 1e9,
    **{name: _measured(name) for name in ("i_c_a", "x_m", "u_c_v", "x_ref_m")},
    "mode": lambda message: _MODES.get(message.mode, str(message.mode)),
    "flags": attrgetter("flags"),
    "lost_before": attrgetter("lost_before"),
}
HEADER = ",".join(_VALUES)  # of CSV


def state(message: pb.State, *, lost: int | None = None) -> Table:
    """Return a sample; `lost` replaces the samples missing before it."""
    values = {name: value_of(message) for name, value_of in _VALUES.items()}
    return values if lost is None else values | {"lost_before": lost}


def json_columns(messages: Sequence[pb.State]) -> bytes:
    """Return samples as columns, in JSON."""
    return _STATES.dump_json(_columns(messages))


def csv_table(messages: Sequence[pb.State]) -> str:
    """Return samples as CSV with a header; an absent number is an empty cell, as in `board51 export`."""
    rows = map(_line, zip(*_columns(messages).values(), strict=True))
    return "".join(f"{line}\n" for line in (HEADER, *rows))


def csv_line(sample: Table) -> str:
    """Return a line of CSV without its end."""
    return _line(sample.values())


def _line(cells: Iterable[object]) -> str:
    return ",".join("" if cell is None else str(cell) for cell in cells)


def _columns(messages: Sequence[pb.State]) -> dict[str, list[Any]]:
    return {name: [value_of(message) for message in messages] for name, value_of in _VALUES.items()}


def entry(board: BoardFeed) -> Table:
    """Return a line of the list of rigs."""
    line = snapshot.summary(board)
    return {"name": board.name, "alarms": line["alarms"], "fault": line["fault"], "x_m": line.get("x_m"), **_now(line)}


def rig(board: BoardFeed) -> Table:
    """Return the status of a rig."""
    now, model, status = snapshot.now(board), board.latest(pb.TwinModel), board.latest(pb.Status)
    return {
        "name": board.name,
        "reason": now["reason"],
        "flags": now.get("flags", []),
        "alarms": alarms(board),
        "twin": now["twin"],
        "divergence": _divergence(now) if "nis_mean" in now else None,
        "model": snapshot.fields(model, "name", "sha256", "who") if model is not None else None,
        "limits": _limits(board.latest(pb.Parameters)),
        "log_state": status.log_state if status is not None else "",
        **_now(now),
    }


def alarms(board: BoardFeed) -> list[Table]:
    """Return the alarms of a rig."""
    return [
        {
            **snapshot.fields(alarm, "name", "text", "active", "acknowledged", "acknowledger", "times"),
            "severity": "fault" if alarm.severity == "fault" else "warning",
            "since_s": alarm.since_ns / 1e9,
            "shelved_until_s": alarm.shelved_until_ns / 1e9 if alarm.is_shelved else None,
        }
        for alarm in board.all_alarms()
    ]


def event(message: pb.Event) -> Table:
    """Return an event."""
    whole = snapshot.fields(message, "tick", "session", "source", "severity", "name", "text")
    return {"host_time_s": message.host_time_ns / 1e9, **whole}


def capture(record: pb.CaptureRecord) -> Table:
    """Return a capture."""
    return {
        **snapshot.fields(record, "session", "tick", "sample_time_s", "u_from_v", "u_to_v"),
        "t_s": [round((n - record.step_index) * record.sample_time_s, 9) for n in range(len(record.i_c_a))],
        "i_c_a": list(record.i_c_a),
    }


def capture_csv(record: pb.CaptureRecord) -> str:
    """Return the samples of a capture as CSV with a header; u_c is the input that was asked for."""
    made = capture(record)
    rows = (
        _line((t_s, i_c_a, record.u_from_v if n < record.step_index else record.u_to_v))
        for n, (t_s, i_c_a) in enumerate(zip(made["t_s"], made["i_c_a"], strict=True))
    )
    return "".join(f"{line}\n" for line in ("t_s,i_c_a,u_c_v", *rows))


def reply(answer: pb.CommandReply) -> shapes.Reply:
    """Return the outcome of an act."""
    code = "" if answer.accepted else answer.reason
    return {
        "executed": answer.accepted,
        "code": code,
        "message": sentence(answer.text),
        "remedy": remedy_of(code) if code else "",
        "refused_by": answer.refused_by,
        "tick": answer.tick,
    }


def _now(now: Table) -> Table:
    mode = now.get("mode")
    return {
        **{name: now.get(name) for name in ("link", "age_s", "coil", "x_ref_m")},
        "mode": mode.replace(" ", "-") if mode is not None else None,
    }


def _divergence(now: Table) -> shapes.Divergence:
    return {
        "error_x_m": now["error_x_m"],
        "error_x_sigma": now["error_x"],
        "error_i_c_a": now["error_i_a"],
        "nis_mean": now["nis_mean"],
        "nis_on": now["nis_on"],
    }


def _limits(parameters: pb.Parameters | None) -> Table | None:
    if parameters is None:
        return None
    low_m, high_m = reference_range(parameters)
    same = ("x_ref_step_max_m", "u_max_v", "sample_time_s", "i_0_a", "x_0_m", "u_0_v", "firmware")
    return {
        **snapshot.fields(parameters, *same),
        "x_ref_min_m": low_m,
        "x_ref_max_m": high_m,
        "law": "pid" if parameters.law == pb.LAW_PID else "lqi",
        "gains": list(parameters.gains),
    }
