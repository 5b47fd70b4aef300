"""The rigs as Prometheus reads them at /metrics, made from the bus when it asks; between two scrapes it costs nothing.

Rule 1: a name ends with its unit, in base units (meters, amperes, seconds, bytes); a counter with total, a share or a
        figure without unit with ratio.  A flag is named after the meaning of its 1.
Rule 2: an unknown value is left out, because an absent position is not 0.
Rule 3: the labels are bounded: rigs, causes, severities and modes are few, alarms at most 64 of a rig.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed
from gateway.views.hmi import snapshot
from gateway.views.hmi.programs import METRICS
from protocol.bus import board51_pb2 as pb
from protocol.wire.decoder import CAUSES

PREFIX = "board51_"
Value = float | None
# name, help, value of a board
_GAUGES: tuple[tuple[str, str, Callable[[BoardFeed], Value]], ...] = (
    ("link_live", "Whether samples arrive.", lambda b: float(b.link().live)),
    ("sample_age_seconds", "Age of the newest sample.", lambda b: b.age_s(pb.State)),
    ("position_meters", "Position of the ball, up from the sensor.", lambda b: _state(b, "x_m")),
    ("position_reference_meters", "Reference of the position.", lambda b: _state(b, "x_ref_m")),
    ("current_amperes", "Coil current.", lambda b: _state(b, "i_c_a")),
    ("input_volts", "Input of the coil's driver.", lambda b: _state(b, "u_c_v")),
    ("twin_in_step", "Whether the twin follows the rig.", lambda b: _twin(b)),
    ("divergence_position_meters", "Measured minus modelled position.", lambda b: _now(b, "error_x_m")),
    ("divergence_position_ratio", "The same over its standard deviation by noise.", lambda b: _now(b, "error_x")),
    ("divergence_current_amperes", "Measured minus modelled coil current.", lambda b: _now(b, "error_i_a")),
    ("innovation_ratio", "Mean normalised innovation squared; 2: noise alone.", lambda b: _now(b, "nis_mean")),
    ("line_load_ratio", "Used share of the line from the board.", lambda b: _status(b, "line_load")),
    ("publish_latency_p99_seconds", "Last byte read to handed to the bus, 99 of 100.", lambda b: _latency(b)),
    ("log_writing", "Whether the log is being written.", lambda b: _log(b)),
)
# name without _total, help, field of Status
_COUNTERS = (
    ("samples_received", "Samples since the gateway's start.", "samples"),
    ("samples_lost", "Ticks that did not arrive.", "samples_lost"),
    ("received_bytes", "Bytes from the board.", "bytes_received"),
    ("sent_bytes", "Bytes to the board.", "bytes_sent"),
    ("reconnections", "How often the port was opened again.", "reconnects"),
    ("board_resets", "Resets of the board that the gateway saw.", "board_resets"),
    ("commands_executed", "Commands that the board, or the gateway for itself, accepted.", "commands_accepted"),
    ("commands_refused", "Commands that gateway or board refused.", "commands_refused"),
    ("commands_unanswered", "Commands that the board did not answer.", "commands_timed_out"),
    ("publish_dropped", "Messages that the bus did not take in time.", "publish_dropped"),
    ("log_dropped", "Messages that the disk did not take in time.", "log_dropped"),
)


class Rigs(Collector):
    """Makes the metrics of all boards of a feed."""

    def __init__(self, feed: Feed, release: str) -> None:
        self._feed, self._release = feed, release

    def collect(self) -> Iterable[Metric]:
        """Yield the metrics as of now."""
        boards = self._feed.board_feeds()
        yield InfoMetricFamily(f"{PREFIX}build", "This software.", {"version": self._release})
        for name, text, value_of in _GAUGES:
            gauge = GaugeMetricFamily(PREFIX + name, text, labels=["rig"])
            for board in boards:
                value = value_of(board)
                if value is not None and math.isfinite(value):
                    gauge.add_metric([board.name], value)
            yield gauge
        for name, text, field in _COUNTERS:
            counter = CounterMetricFamily(PREFIX + name, text, labels=["rig"])
            for board in boards:
                count = _status(board, field)
                if count is not None:
                    counter.add_metric([board.name], count)
            yield counter
        yield from _labelled(boards)


def _labelled(boards: list[BoardFeed]) -> Iterable[Metric]:
    errors = CounterMetricFamily(f"{PREFIX}link_errors", "Bad frames from the board.", labels=["rig", "cause"])
    modes = GaugeMetricFamily(f"{PREFIX}mode", "1 for the mode that is on.", labels=["rig", "mode"])
    alarms = GaugeMetricFamily(f"{PREFIX}alarms", "Number of active alarms.", labels=["rig", "severity"])
    active = GaugeMetricFamily(f"{PREFIX}alarm_active", "1 for each active alarm.", labels=["rig", "alarm", "severity"])
    for board in boards:
        status, state = board.latest(pb.Status), board.latest(pb.State)
        if status is not None:
            for cause in CAUSES:
                errors.add_metric([board.name, cause], status.bad_frames.get(cause, 0))
        if state is not None:
            for mode, word in snapshot.MODES.items():
                modes.add_metric([board.name, word.replace(" ", "-")], float(state.mode == mode))
        raised = [alarm for alarm in board.alarms() if alarm.active]
        for severity in ("warning", "fault"):
            alarms.add_metric([board.name, severity], sum(alarm.severity == severity for alarm in raised))
        for alarm in raised:
            active.add_metric([board.name, alarm.name, alarm.severity], 1.0)
    return errors, modes, alarms, active


def route(feed: Feed, release: str) -> Route:
    """Return the route of /metrics."""
    registry = CollectorRegistry()
    registry.register(Rigs(feed, release))

    async def metrics(request: Request) -> Response:
        encode, media_type = choose_encoder(request.headers.get("accept", ""))
        text = await asyncio.to_thread(encode, registry)
        return Response(text, headers={"content-type": media_type})

    return Route(METRICS, metrics, methods=["GET"])


def _state(board: BoardFeed, name: str) -> Value:
    state = board.latest(pb.State)
    return getattr(state, name) if state is not None and state.HasField(name) and board.link().live else None


def _now(board: BoardFeed, name: str) -> Value:
    value: Value = snapshot.now(board).get(name)
    return value


def _twin(board: BoardFeed) -> Value:
    twin = snapshot.now(board)["twin"]
    return None if twin == "none" else float(twin == "in-step")


def _status(board: BoardFeed, name: str) -> Value:
    status = board.latest(pb.Status)
    return None if status is None else float(getattr(status, name))


def _latency(board: BoardFeed) -> Value:
    milliseconds = _status(board, "latency_p99_ms")
    return None if milliseconds is None else milliseconds * 1e-3


def _log(board: BoardFeed) -> Value:
    status = board.latest(pb.Status)
    return None if status is None or status.log_state == "off" else float(status.log_state == "writing")
