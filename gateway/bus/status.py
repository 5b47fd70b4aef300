"""Builds pb.Status and pb.Alarms of one board from the counters of its parts."""

from __future__ import annotations

from gateway.board import faults
from gateway.board.conditions import LINK, LOG, TO_BOARD, Condition, Standing
from gateway.bus.publisher import BoardSink
from gateway.link.driver import BoardDriver
from gateway.record.recorder import RecorderStats
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag

_BITS_PER_BYTE = 10  # 8N1


def percentile(values: list[float], share: float) -> float:
    """Return the percentile `share` (0 .. 1) of `values` by nearest rank; 0 without values."""
    if not values:
        return 0.0
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


class StatusMaker:
    """Makes one board's status; rates are over the time since the last call."""

    def __init__(self, driver: BoardDriver, sink: BoardSink, now_s: float) -> None:
        self._driver, self._sink = driver, sink
        self._started_s = self._last_s = now_s
        self._last_samples = self._last_bytes = 0
        self._standing = Standing()

    def make(self, log: RecorderStats | None, now_s: float) -> pb.Status:
        """Return the current status; `log` is None if no log is written."""
        driver, session = self._driver, self._driver.session
        counters, unwrapper, counts, handler = session.counters, session.unwrapper, driver.counts, driver.handler
        elapsed_s = max(now_s - self._last_s, 1e-3)
        samples, received = counts.samples, driver.from_board.bytes_received
        new_samples, new_bytes = samples - self._last_samples, received - self._last_bytes
        self._last_s, self._last_samples, self._last_bytes = now_s, samples, received
        latencies_s = self._sink.state_channel.take_latencies_s()
        status = pb.Status(
            host_time_ns=driver.report.host_ns(),
            link=driver.link,
            port=driver.port,
            uptime_s=now_s - self._started_s,
            session=session.number if session.is_open else 0,
            samples_per_s=new_samples / elapsed_s,
            samples=samples,
            samples_lost=unwrapper.lost,
            bytes_received=received,
            bytes_sent=counts.bytes_sent,
            reconnects=max(0, counts.opened - 1),
            board_resets=counters.board_resets,
            commands_accepted=handler.accepted_count,
            commands_refused=handler.refused_count,
            commands_timed_out=handler.timed_out_count,
            latency_p50_ms=percentile(latencies_s, 0.5) * 1e3,
            latency_p99_ms=percentile(latencies_s, 0.99) * 1e3,
            publish_queue_depth=max(0, self._sink.waiting),
            publish_dropped=self._sink.dropped,
            log_state="off",
            line_load=new_bytes * _BITS_PER_BYTE / elapsed_s / driver.config.baud,
            board_bad_frames=driver.keepalive.board_bad_frames,
            board_overruns=driver.keepalive.board_overruns,
            states=counters.states,
            to_board=driver.to_board.state,
            unanswered_s=driver.to_board.unanswered_s(now_s),
            last_stop_ns=driver.stopped_ns,
        )
        status.states_ignored.update({**session.states_ignored, "not-served": counts.samples_refused})
        status.bad_frames.update(counters.bad_frames)
        status.bad_frames.update(
            {
                "implausible": unwrapper.implausible,
                "duplicate": unwrapper.duplicates,
                "stray-answer": counters.stray_answers,
                "events-lost": counters.events_lost,
            }
        )
        if log is not None:
            status.log_queue_depth, status.log_dropped = log.depth, log.dropped
            status.log_file, status.log_bytes, status.log_state = log.file, log.bytes, log.state
        return status

    def send(self, log: RecorderStats | None, now_s: float) -> None:
        """Send the status, and the alarms if they are due."""
        status, alarms = self.make(log, now_s), self.alarms(log, now_s)
        self._sink.send("status", status, status.host_time_ns)
        if alarms is not None:
            self._sink.send("alarms", alarms, alarms.host_time_ns)

    def alarms(self, log: RecorderStats | None, now_s: float) -> pb.Alarms | None:
        """Return active conditions and acknowledgements if they are due, else None."""
        driver, report, holding = self._driver, self._driver.report, dict[str, Condition]()
        if driver.link != "streaming":
            holding[LINK] = Condition(text=report.reason, since_ns=report.since_ns)
        if report.unanswered is not None:
            holding[TO_BOARD] = Condition(text=report.unanswered.text, since_ns=report.unanswered.host_time_ns)
        sample = driver.known.sample
        if sample is not None and sample.state.flags & Flag.FAULT:
            holding |= fault_condition(report.fault, sample.state.u_c)
        if log is not None and log.state not in ("writing", "off"):
            holding[LOG] = Condition(text=f"The log is not written: {log.state}.")
        acknowledged = driver.handler.annotations.acknowledged
        return self._standing.due_message(holding, acknowledged, host_ns=report.host_ns(), now_s=now_s)


def fault_condition(event: pb.Event | None, u_c: int) -> dict[str, Condition]:
    """Return the fault that the FAULT flag means: the event before it, unless u_c contradicts that event."""
    if u_c > 0 and (event is None or event.name not in faults.COIL):
        return {faults.OUTPUT_FAULT: Condition(text=faults.OUTPUT_UNCONFIRMED)}
    if event is None:
        return {faults.FAULT: Condition(text=faults.FAULT_TEXT)}
    return {event.name: Condition(text=event.text, since_ns=event.host_time_ns)}
