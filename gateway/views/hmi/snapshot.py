"""Data of a board for a page, as plain data for JSON: `now` with each frame, `rest` on change.

`rest` has a version, so that it is not sent again to a reader that has it.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from typing import Any

from gateway.board.faults import COIL
from gateway.board.reference import reference_range_mm
from gateway.views.alarms import TWIN, Alarm, Entry
from gateway.views.board_feed import TWIN_TIMEOUT_S, BoardFeed
from gateway.views.hmi.jobs import Job
from gateway.views.hmi.model.numbers import SPOKEN, in_numbers
from gateway.views.hmi.model.plant import stated_ms
from gateway.views.hmi.texts import text_of, texts_of
from gateway.views.hmi.traces import number
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import word_of
from protocol.bus.plant_card import plant_of
from protocol.plant import in_words
from protocol.wire.decoder import CAUSES
from protocol.wire.messages import Flag

# Names of texts; static/hmi.js and stop.js compare with "idle".
MODES = {mode: word_of(pb.Mode, mode) for mode in pb.Mode.values()}
_FLAGS = {
    Flag.FAULT: "fault",
    Flag.HOST_LOST: "host-lost",
    Flag.POSITION_RANGE: "position-clipped",
    Flag.CURRENT_RANGE: "current-clipped",
    Flag.INPUT_SATURATED: "input-saturated",
    Flag.OVERRUN: "overrun",
}
COIL_IN_DOUBT = "in-doubt"  # static/stop.js compares with it
MAX_EVENTS = 30
MAX_LINES = 12
_GAPS = re.compile(r"\s{2,}")
TWIN_STALE_S = 1.0


def now(board: BoardFeed) -> dict[str, Any]:
    """The newest values."""
    link, state = board.link(), board.latest(pb.State)
    picture: dict[str, Any] = {
        "link": link.state,
        "reason": link.reason,
        "age_s": round(link.age_s, 2) if math.isfinite(link.age_s) else None,
    }
    if state is not None:
        picture |= {
            "session": state.session,
            "at": _clock(state.host_time_ns),
            "host_s": round(state.host_time_ns / 1e9, 3),
            "tick": state.tick,
            "t_s": round(state.t_s, 3),
            **{
                name: number(getattr(state, name)) if state.HasField(name) else None
                for name in ("x_m", "x_ref_m", "i_c_a", "u_c_v")
            },
            "mode": MODES.get(state.mode, str(state.mode)),
            "coil": _coil(board, state),
            "flags": [name for flag, name in _FLAGS.items() if state.flags & flag],
        }
    twin, divergence = board.latest(pb.TwinState), board.latest(pb.Divergence)
    if divergence is None:
        picture["twin"] = "none"
    elif board.age_s(pb.Divergence) > TWIN_STALE_S:
        picture["twin"] = "stale"
    else:
        picture |= {
            "twin": divergence.sync,
            "error_x": number(divergence.x_m.normalised, 3),
            "error_x_m": number(divergence.x_m.error, 3),
            "error_i_a": number(divergence.i_c_a.error, 3),
            "nis_mean": number(divergence.nis_mean, 3) if divergence.innovation_valid else None,
            "nis_on": number(divergence.nis_on, 4) or None,
        }
        if twin is not None and board.age_s(pb.TwinState) <= TWIN_STALE_S:
            picture["twin_x_m"] = number(twin.x_m)
    return picture


def rest(board: BoardFeed) -> dict[str, Any]:
    """Return health, limits, alarms, events and commands."""
    sentences = _in_numbers(board)
    return {
        "wrong": next(iter(sentences.values()), ""),
        "named": _named(board),
        "status": _status(board),
        "limits": _limits(board.latest(pb.Parameters)),
        "model": _model(board.latest(pb.TwinModel)),
        "plant_ms": stated_ms(board.latest(pb.PlantCard)),
        "alarms": [
            {
                **fields(a, "name", "severity", "active", "acknowledged", "times"),
                "text": sentences.get(a.name, a.text),
                "group": _group(a),
                "until": _clock(a.shelved_until_ns)[:5],
                "model": a.of_twin and a.name != TWIN,  # what to do about it is on the page of the model
                "by": a.acknowledger,
                "value": number(a.value, 3) if a.value is not None else None,
                "since": _moment(a.since_ns),
                "at_s": round(a.since_ns / 1e9, 3),
            }
            for a in board.all_alarms()
        ],
        "events": [
            {
                "at": _moment(e.host_time_ns),
                "at_s": round(e.host_time_ns / 1e9, 3),
                **fields(e, "source", "severity", "name", "text"),
            }
            for e in board.events()[: -MAX_EVENTS - 1 : -1]
        ],
        "excitation": _excitation(board.commands()),
        "commands": [_command(record) for record in board.commands()[: -MAX_EVENTS - 1 : -1]],
    }


def journal(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Return the history of the alarms, in words."""
    words = texts_of("journal_of")
    return [
        {
            "at": _moment(e.at_ns, dated=True),
            "severity": e.severity if e.what == "came" else "info",
            "name": e.name,
            "what": words[e.what if e.who else f"{e.what}_alone"].format(who=e.who, until=_clock(e.until_ns)[:5]),
            "text": e.text,
        }
        for e in entries
    ]


def _group(alarm: Alarm) -> str:
    if alarm.is_shelved:
        return "shelved"
    if not alarm.active:
        return "returned"
    return "acknowledged" if alarm.acknowledged else "unacknowledged"


def _in_numbers(board: BoardFeed) -> dict[str, str]:
    """Return the present errors of the model in numbers, by the names of the active alarms, the plainest first."""
    divergence = board.latest(pb.Divergence)
    if divergence is None or board.age_s(pb.Divergence) > TWIN_STALE_S:
        return {}
    since = {alarm.name: _moment(alarm.since_ns)[:-3] for alarm in board.alarms() if alarm.active}
    sentences = {name: in_numbers(name, since[name], divergence) for name in SPOKEN if name in since}
    return {name: sentence for name, sentence in sentences.items() if sentence}


def _named(board: BoardFeed) -> str:
    """Return what the twin proposes as the cause of the error; empty where it names none."""
    diagnosis = board.latest(pb.TwinDiagnosis)
    if diagnosis is None or not diagnosis.cause or board.age_s(pb.TwinDiagnosis) > TWIN_TIMEOUT_S:
        return ""
    seconds, since = f"{diagnosis.for_s:.0f}", _moment(diagnosis.since_ns)
    sentence, probability = diagnosis.sentence, f"{diagnosis.probability:.1g}"
    return text_of("rig.named", seconds=seconds, sentence=sentence, probability=probability, since=since)


def job(running: Job) -> dict[str, Any]:
    """Return the lines that a page shows of a job; columns of a table do not fit into a card, so dots separate them."""
    lines = [_GAPS.sub(" \u00b7 ", line.strip()) for line in list(running.lines)[-MAX_LINES:]]
    return {**fields(running, "title", "who", "running", "standing", "failed", "progress"), "lines": lines}


def summary(board: BoardFeed) -> dict[str, Any]:
    """Return the entry of a board in the list of all boards."""
    listed, model = board.alarms(), board.latest(pb.TwinModel)
    alarms = [alarm for alarm in listed if not alarm.is_shelved]
    return now(board) | {
        "name": board.name,
        "model": model.name if model is not None else "",
        "unseen": board.is_unseen(),
        "alarms": sum(a.active for a in alarms),
        "shelved": len(board.shelved()),
        "gone": sum(not a.active for a in alarms),  # that nobody has acknowledged
        # Also a shelved one: a user of the overview may not have shelved it, and must see which rig has a fault.
        "fault": any(a.active and a.severity == "fault" for a in listed),
    }


def _excitation(records: Sequence[pb.CommandRecord]) -> dict[str, Any] | None:
    """Return shape and end (Unix time; 0: never) of the excitation that plays, as far as the commands show."""
    for record in reversed(records):
        command, what = record.command, record.command.WhichOneof("what")
        if not record.reply.accepted or what not in ("excite", "stop", "set_mode"):
            continue
        if what != "excite" or command.excite.shape == pb.SHAPE_NONE:
            return None
        duration_s = command.excite.duration_s
        until_s = round(record.received_ns / 1e9 + duration_s, 1) if duration_s else 0
        return {"what": word_of(pb.Shape, command.excite.shape), "until_s": until_s}
    return None


def _coil(board: BoardFeed, state: pb.State) -> str:
    if board.fault() in COIL:
        return COIL_IN_DOUBT
    return "off" if state.mode == pb.MODE_IDLE else "on"


def fields(source: object, *names: str) -> dict[str, Any]:
    """Return the values of these names."""
    return {name: getattr(source, name) for name in names}


def _status(board: BoardFeed) -> dict[str, Any] | None:
    status = board.latest(pb.Status)
    if status is None:
        return None
    return {
        **fields(status, "port", "to_board", "reconnects", "log_state", "log_file", "log_dropped"),
        "age_s": round(board.age_s(pb.Status)),
        "samples_per_s": round(status.samples_per_s),
        "lost": status.samples_lost,
        "bad_frames": sum(count for cause, count in status.bad_frames.items() if cause in CAUSES),
        "unexpected": {cause: count for cause, count in status.bad_frames.items() if cause not in CAUSES and count},
        "latency_p99_ms": number(status.latency_p99_ms, 2),
        "line_load": round(100 * status.line_load),
        "dropped": status.publish_dropped,
        "resets": status.board_resets,
        "log_mb": round(status.log_bytes / 1e6, 1),
    }


def _limits(parameters: pb.Parameters | None) -> dict[str, Any] | None:
    if parameters is None:
        return None
    low_mm, high_mm = reference_range_mm(parameters)
    return {
        "x_min_mm": low_mm,
        "x_max_mm": high_mm,
        "step_m": parameters.x_ref_step_max_m,
        "u_max_v": parameters.u_max_v,
        "law": "PID" if parameters.law == pb.LAW_PID else "LQI",
        "gains": [number(gain, 4) for gain in parameters.gains],
        "firmware": parameters.firmware,
    }


def _model(model: pb.TwinModel | None) -> dict[str, Any] | None:
    if model is None:
        return None
    return {"name": model.name, "sha256": model.sha256[:12], "who": model.who}


def _command(record: pb.CommandRecord) -> dict[str, Any]:
    command, reply = record.command, record.reply
    return {
        "at": _moment(record.received_ns),
        "who": command.who,
        "what": describe(command),
        "result": text_of("command.accepted")
        if reply.accepted
        else text_of("command.refused", by=reply.refused_by, reason=reply.reason),
        "accepted": reply.accepted,
        "text": reply.text,
    }


def describe(command: pb.Command) -> str:
    """A command in words."""
    match command.WhichOneof("what"):
        case "set_mode":
            mode = MODES.get(command.set_mode.mode, "")
            return text_of("command.set_mode", mode=texts_of("mode").get(mode, command.set_mode.mode))
        case "set_reference":
            return text_of("command.set_reference", mm=f"{command.set_reference.x_ref_m * 1e3:.3f}")
        case "mark":
            return text_of("command.mark", text=command.mark.text)
        case "acknowledge":
            alarm, shelve_s = command.acknowledge.alarm, command.acknowledge.shelve_s
            if not shelve_s:
                return text_of("command.acknowledge", alarm=alarm)
            return text_of("command.shelve", alarm=alarm, minutes=f"{shelve_s / 60:g}")
        case "set_gains":
            law = "PID" if command.set_gains.law == pb.LAW_PID else "LQI"
            gains = ", ".join(f"{gain:.4g}" for gain in command.set_gains.gains)
            return text_of("command.set_gains", law=law, gains=gains)
        case "set_plant":
            return text_of("command.set_plant", plant=in_words(plant_of(command.set_plant.plant)))
        case "excite":
            e = command.excite
            if e.shape == pb.SHAPE_NONE:
                return text_of("command.excite_end")
            name = word_of(pb.Shape, e.shape)
            shape = texts_of("shape").get(name, name)
            if not e.duration_s:
                return text_of("command.excite", shape=shape)
            return text_of("command.excite_for", shape=shape, seconds=f"{e.duration_s:g}")
        case None:
            return text_of("command.nothing")
        case what:
            return str(what).replace("_", " ")


def _moment(time_ns: int, *, dated: bool = False) -> str:
    """Return the local time, with its date where it is not of today."""
    if not time_ns:
        return ""
    then = time.localtime(time_ns / 1e9)
    form = "%H:%M:%S" if then[:3] == time.localtime()[:3] and not dated else "%Y-%m-%d %H:%M:%S"
    return time.strftime(form, then)


def _clock(time_ns: int) -> str:
    return time.strftime("%H:%M:%S", time.localtime(time_ns / 1e9)) if time_ns else ""
