"""The answers about rigs, from what the bus says of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from gateway.board.reference import reference_range
from gateway.client.values import Sample
from gateway.views.feed import BoardFeed
from gateway.views.hmi import snapshot
from gateway.views.hmi.api import shapes
from gateway.views.hmi.problems import remedy_of, sentence
from protocol.bus import board51_pb2 as pb

COLUMNS = tuple(field.name for field in fields(shapes.State))
HEADER = ",".join(COLUMNS)  # of CSV


def state(message: pb.State, *, lost: int | None = None) -> shapes.State:
    """Return a sample; `lost` replaces the samples missing before it."""
    sample = Sample.of(message)
    return shapes.State(
        t_s=sample.t_s,
        tick=sample.tick,
        session=sample.session,
        host_time_s=message.host_time_ns / 1e9,
        i_c_a=sample.i_c_a,
        x_m=sample.x_m,
        u_c_v=sample.u_c_v,
        x_ref_m=sample.x_ref_m,
        mode=sample.mode.value,
        flags=sample.flags,
        lost_before=sample.lost_before if lost is None else lost,
    )


def columns(messages: Sequence[pb.State]) -> shapes.States:
    """Return samples as columns."""
    rows = [state(message) for message in messages]
    return shapes.States(**{name: [getattr(row, name) for row in rows] for name in COLUMNS})


def csv_table(messages: Sequence[pb.State]) -> str:
    """Return samples as CSV with a header."""
    return "".join(f"{line}\n" for line in (HEADER, *(csv_line(state(message)) for message in messages)))


def csv_line(sample: shapes.State) -> str:
    """Return a line of CSV without its end; an absent number is an empty cell, as in `board51 export`."""
    cells = (getattr(sample, name) for name in COLUMNS)
    return ",".join("" if isinstance(cell, float) and math.isnan(cell) else str(cell) for cell in cells)


def entry(board: BoardFeed) -> shapes.RigEntry:
    """Return a line of the list of rigs."""
    line = snapshot.summary(board)
    return shapes.RigEntry(
        name=board.name,
        alarms=line["alarms"],
        fault=line["fault"],
        x_m=line.get("x_m"),
        **_now(line),
    )


def rig(board: BoardFeed) -> shapes.Rig:
    """Return the status of a rig."""
    now, model, status = snapshot.now(board), board.latest(pb.TwinModel), board.latest(pb.Status)
    return shapes.Rig(
        name=board.name,
        reason=now["reason"],
        flags=now.get("flags", []),
        alarms=[
            shapes.AlarmEntry(
                name=alarm.name,
                severity="fault" if alarm.severity == "fault" else "warning",
                text=alarm.text,
                active=alarm.active,
                acknowledged=alarm.acknowledged,
                acknowledger=alarm.acknowledger,
                since_s=alarm.since_ns / 1e9,
                times=alarm.times,
            )
            for alarm in board.alarms()
        ],
        twin=now["twin"],
        divergence=_divergence(now) if "nis_mean" in now else None,
        model=shapes.TwinModel(name=model.name, sha256=model.sha256, who=model.who) if model is not None else None,
        limits=_limits(board.latest(pb.Parameters)),
        log_state=status.log_state if status is not None else "",
        **_now(now),
    )


def reply(answer: pb.CommandReply) -> shapes.Reply:
    """Return the outcome of an act."""
    code = "" if answer.accepted else answer.reason
    return shapes.Reply(
        executed=answer.accepted,
        code=code,
        message=sentence(answer.text),
        remedy=remedy_of(code) if code else "",
        refused_by=answer.refused_by,
        tick=answer.tick,
    )


def _now(now: dict[str, Any]) -> dict[str, Any]:
    mode = now.get("mode")
    return {
        "link": now["link"],
        "age_s": now["age_s"],
        "mode": mode.replace(" ", "-") if mode is not None else None,
        "coil": now.get("coil"),
        "x_ref_m": now.get("x_ref_m"),
    }


def _divergence(now: dict[str, Any]) -> shapes.Divergence:
    return shapes.Divergence(
        error_x_m=now["error_x_m"],
        error_x_sigma=now["error_x"],
        error_i_c_a=now["error_i_a"],
        nis_mean=now["nis_mean"],
        nis_on=now["nis_on"],
    )


def _limits(parameters: pb.Parameters | None) -> shapes.Limits | None:
    if parameters is None:
        return None
    low_m, high_m = reference_range(parameters)
    return shapes.Limits(
        x_ref_min_m=low_m,
        x_ref_max_m=high_m,
        x_ref_step_max_m=parameters.x_ref_step_max_m,
        u_max_v=parameters.u_max_v,
        sample_time_s=parameters.sample_time_s,
        law="pid" if parameters.law == pb.LAW_PID else "lqi",
        gains=list(parameters.gains),
        i_0_a=parameters.i_0_a,
        x_0_m=parameters.x_0_m,
        u_0_v=parameters.u_0_v,
        firmware=parameters.firmware,
    )
