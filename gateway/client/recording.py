"""Record the bus to MCAP files independently of the gateway's log: `board51 record` and `Rig.record`.

The raw bytes of the UART are not on the bus; only the gateway's own log has them.
"""

from __future__ import annotations

import threading
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Self

import zenoh
from google.protobuf.message import Message

from gateway.client.connection import BusBoard, Subscription
from gateway.client.values import Samples, read_log
from gateway.record.recorder import Recorder, RecorderOptions, RecorderStats
from protocol.bus import topics
from protocol.bus.encoding import parse, stamp_ns
from protocol.files import make_folder


class LogTimes:
    """The log times of messages: that of the gateway, as in its own log.

    A message without a time (twin/*) gets that of its board's newest message, as the clock of this host may differ.
    """

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}

    def of(self, board: str, message: Message | None) -> int:
        """Return the time of a message that has just arrived, Unix time in ns; None: it is not valid."""
        stamp = None if message is None else stamp_ns(message)
        if stamp is not None:
            self._newest_ns[board] = max(stamp, self._newest_ns.get(board, 0))
        return stamp or self._newest_ns.get(board, time.time_ns())


class Recording(AbstractContextManager["Recording"]):
    """A recording of all logged topics of one board, or of all boards, from `start` until `close`.

    A new file is begun at `rotate_bytes` or after `rotate_s`; its metadata names `connect`, the router's endpoint.

    Raises:
        UsageError: the directory cannot be created, or the prefix is not a valid name.
    """

    def __init__(
        self,
        board: BusBoard,
        directory: Path | str,
        *,
        connect: str,
        prefix: str = "bus",
        rotate_bytes: int = 500_000_000,
        rotate_s: float = 3600.0,
    ) -> None:
        topics.check_name(prefix, what="prefix")
        self._board, self._keys = board, f"{board}/**"
        make_folder(Path(directory))
        self._recorder = Recorder(
            Path(directory),
            RecorderOptions(prefix=prefix, rotate_bytes=rotate_bytes, rotate_s=rotate_s),
            metadata={"record": {"connect": connect, "keys": self._keys}},
        )
        self._times = LogTimes()
        self._closed = threading.Event()
        self._subscription: Subscription | None = None

    def start(self, *, needs_room: bool = False) -> Self:
        """Open the first file and subscribe; unless it `needs_room`, on a full disk it begins when there is room.

        Raises:
            LogError: the directory cannot be written to.
        """
        self._recorder.start(needs_room=needs_room)
        try:
            self._subscription = Subscription(self._board.session, [self._keys], self._arrived)
        except BaseException:
            self._recorder.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> RecorderStats:
        """End the recording and finish the file; returns its statistics.  May be called again."""
        try:
            if self._subscription is not None:
                self._subscription.close()  # delivers what has arrived
        finally:
            self._closed.set()  # a closed recorder would count later messages as dropped
            self._recorder.close()
        return self._recorder.stats()

    @property
    def stats(self) -> RecorderStats:
        """Messages written and dropped so far, and the current file."""
        return self._recorder.stats()

    @property
    def files(self) -> list[Path]:
        """The files so far, in their order."""
        return list(self._recorder.files)

    def samples(self) -> Samples:
        """The recorded samples as arrays of shape (n,), SI units; call it after `close`.

        Raises:
            DataError: there are no samples, or several boards were recorded.
        """
        return read_log(self.files, board=None if self._board.board == "*" else self._board.board)

    def _arrived(self, sample: zenoh.Sample) -> None:
        if self._closed.is_set():
            return
        key, data = str(sample.key_expr), sample.payload.to_bytes()
        address = topics.split(key)
        if address is None or not topics.TOPIC_OF_NAME[address[2]].logged:
            return
        _, board, topic = address
        message = parse(topics.TOPIC_OF_NAME[topic].message, data)
        self._recorder.put(key, data, self._times.of(board, message))
