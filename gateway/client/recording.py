"""The bus into MCAP files, without a gateway's log: `board51 record`, and `Rig.record`.

The raw bytes of the UART do not travel on the bus: only the gateway's own log has them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

import zenoh

from gateway.client.values import Samples, read_log
from gateway.record.recorder import Recorder, RecorderStats
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.files import make_folder


class Recording:
    """Everything logged of one board, or of all, from `start` until `close`.

    Args:
        session: of the bus.
        site: first chunk of the keys.
        board: second; "*": every board.
        directory: for the parts; made if absent.
        prefix: first part of the file names.
        rotate_bytes: a larger part is closed.
        rotate_s: an older part is closed, s.
        metadata: of every part.
        on_event: told (name, severity, text) of what becomes of the log.

    Raises:
        UsageError: the directory cannot be made, or the prefix is no name.
    """

    def __init__(
        self,
        session: zenoh.Session,
        site: str,
        board: str,
        directory: Path | str,
        *,
        prefix: str = "bus",
        rotate_bytes: int = 500_000_000,
        rotate_s: float = 3600.0,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        on_event: Callable[[str, str, str], None] | None = None,
    ) -> None:
        topics.check_name(prefix, what="prefix")
        self._session, self._keys, self._board = session, f"{site}/{board}/**", board
        make_folder(Path(directory))
        self._recorder = Recorder(
            Path(directory),
            prefix=prefix,
            rotate_bytes=rotate_bytes,
            rotate_s=rotate_s,
            metadata=metadata or {"record": {"keys": self._keys}},
            on_event=on_event,
        )
        self._newest_ns: dict[str, int] = {}
        self._closed = threading.Event()
        self._subscriber: zenoh.Subscriber[None] | None = None

    def start(self) -> Self:
        """Open the first part and listen.

        Raises:
            LogError: the directory is read-only or full.
        """
        self._recorder.start()
        try:
            self._subscriber = self._session.declare_subscriber(self._keys, self._arrived)
        except BaseException:
            self._recorder.close()
            raise
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> RecorderStats:
        """End it and finish the file; may be called again.  What came, in numbers."""
        # What comes from here on is not part of the recording: a closed recorder would count it as dropped.
        self._closed.set()
        subscriber, self._subscriber = self._subscriber, None
        try:
            if subscriber is not None:
                subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub has no return type
        finally:
            self._recorder.close()
        return self._recorder.stats()

    @property
    def stats(self) -> RecorderStats:
        """Messages written and dropped so far, the part being written."""
        return self._recorder.stats()

    @property
    def files(self) -> list[Path]:
        """The parts so far, in their order."""
        return list(self._recorder.files)

    def samples(self) -> Samples:
        """What was recorded of the board, arrays of shape (n,), SI units; after `close`.

        Raises:
            DataError: nothing came, or several boards were recorded.
        """
        return read_log(self.files, board=None if self._board == "*" else self._board)

    def _arrived(self, sample: zenoh.Sample) -> None:
        if self._closed.is_set():
            return
        key, data = str(sample.key_expr), sample.payload.to_bytes()
        place = topics.split(key)
        if place is None or not topics.BY_NAME[place[2]].logged:
            return
        _, board, topic = place
        message = parse(topics.BY_NAME[topic].message, data)
        # Log time is the gateway's, as in its own log.  What bears no time (twin/*) gets that of the board's newest
        # message: the clock of this host may be another one.
        own_ns: int | None = getattr(message, "host_time_ns", getattr(message, "received_ns", None))
        if own_ns is not None:
            self._newest_ns[board] = max(own_ns, self._newest_ns.get(board, 0))
        self._recorder.put(key, data, self._newest_ns.get(board, time.time_ns()) if own_ns is None else own_ns)
