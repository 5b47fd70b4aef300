"""Reads a capture from the board block by block, from its ACK to the CaptureRecord.  No I/O.

Blocks are read one command at a time, so that other commands can be sent in between.  CAPTURE_DONE may be lost on the
line, so reading begins at the latest at the computed end of the capture.
"""

from __future__ import annotations

from gateway.board.scaling import Scaling, WireCommand
from gateway.link.reporter import LinkReporter
from gateway.link.sink import Sink
from protocol.bus import board51_pb2 as pb
from protocol.wire.codec import unpack_counts
from protocol.wire.events import Answer
from protocol.wire.messages import Message
from protocol.wire.session import Session

_SETTLE_S = 0.02  # u_from is applied this long before the first sample (rule 12)
_MARGIN_S = 0.25  # after the computed end, before reading without CAPTURE_DONE
_AGAIN_S = 0.1  # between attempts while the board says BUSY
_ATTEMPTS = 10


class CaptureReader:
    """Reads the captures of one board, one at a time; without an active capture its methods do nothing."""

    def __init__(self, session: Session, report: LinkReporter, sink: Sink) -> None:
        self.deadline_s = float("inf")  # when `poll` has something to do
        self._session, self._report, self._sink = session, report, sink
        self._under_way = False
        self._token: int | None = None  # of the READ_CAPTURE that is under way

    def accepted(self, wire: WireCommand, scaling: Scaling | None, now_s: float) -> None:
        """Follow a command that the board has accepted: it begins or ends a capture, or neither."""
        if wire.name == "CAPTURE" and scaling is not None:
            self._begin(scaling, wire, now_s)
        elif wire.name in ("STOP", "SET_MODE"):
            self.interrupt("STOP" if wire.name == "STOP" else "a change of mode")

    def _begin(self, scaling: Scaling, wire: WireCommand, now_s: float) -> None:
        self.interrupt("another one")
        self._scaling = scaling
        self._requested = int(wire.values["count"])
        self._record = pb.CaptureRecord(
            session=self._session.number,
            sample_time_s=scaling.capture_time_s,
            u_from_v=scaling.u_v(int(wire.values["u_from"])),
            u_to_v=scaling.u_v(int(wire.values["u_to"])),
            step_index=int(wire.values["pre"]),
        )
        self._counts: list[int] = []
        self._failures = 0
        self._under_way = True
        # Not by CAPTURE_DONE alone: the line may lose it, and the samples would stay unread.
        self.deadline_s = now_s + _SETTLE_S + self._requested * scaling.capture_time_s + _MARGIN_S

    def capture_completed(self, now_s: float) -> None:
        """Read the samples after CAPTURE_DONE has arrived."""
        if self._under_way and self._token is None and not self._counts:
            self._read(now_s)

    def poll(self, now_s: float) -> None:
        """Begin to read if CAPTURE_DONE is missing, and retry after BUSY."""
        if now_s >= self.deadline_s and self._token is None:
            self._read(now_s)

    def interrupt(self, why: str) -> None:
        """Abandon the capture: after STOP, a change of mode or a reset the board has no data."""
        self._end(f"The capture was interrupted by {why}.")

    def answered(self, answer: Answer, now_s: float) -> bool:
        """Process the answer to a READ_CAPTURE; return False for any other answer."""
        if self._token is None or answer.token != self._token:
            return False
        self._token = None
        if answer.outcome == "ack" and answer.message is not None:
            self._block(answer.message, now_s)
        elif answer.outcome == "nack" and self._failures < _ATTEMPTS:
            self._failures += 1
            self.deadline_s = now_s + _AGAIN_S
        else:
            self._end(f"The capture could not be read: {answer.outcome} at sample {len(self._counts)}.")
        return True

    def _read(self, now_s: float) -> None:
        self.deadline_s = float("inf")
        # One block at a time, not all at once: other commands can be sent between two blocks.
        self._token = self._session.submit("READ_CAPTURE", now_s, index=len(self._counts))

    def _block(self, block: Message, now_s: float) -> None:
        total = min(block.int("total"), self._requested)
        if not self._counts:
            self._record.tick = block.int("tick")
        elif block.int("tick") != self._record.tick:
            self._end("The capture was interrupted by another one.")
            return
        # The last block is filled up with zeros, which are no samples.
        self._counts += unpack_counts(block.bytes("samples"))[: total - len(self._counts)]
        if len(self._counts) < total:
            self._read(now_s)
            return
        self._record.i_c_a.extend(self._scaling.i_a(count) for count in self._counts)
        self._end(self._record)

    def _end(self, result: pb.CaptureRecord | str) -> None:
        if self._under_way:
            self._under_way, self._token, self.deadline_s = False, None, float("inf")
            if isinstance(result, str):
                self._report.publish("capture-failed", "warning", result)
            else:
                result.host_time_ns = self._report.host_ns()
                self._sink.send("capture", result, result.host_time_ns)
