"""Replays a log onto the bus under its recorded keys, at any speed.

Rule 1: payloads are sent byte for byte: a twin computes the same from a replay as from the live board.
Rule 2: the order is that of the log; the pace is that of `player`; with speed 0 only the bus limits it.
Rule 3: twin/* is replayed only on request: a live twin publishes it, too, and two sources under one key would mix.
Rule 4: each message is marked as replayed, beside its payload: views of the live rigs leave it out.
Rule 5: each recorded `state` is also sent as `states`, one by one: a longer batch would delay its first sample.
Rule 6: a replay does not publish under the name of a board that is alive on the bus.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from itertools import islice

import zenoh
from google.protobuf.message import Message

from protocol.bus import encoding, topics
from protocol.bus.endpoint import has_subscriber
from protocol.errors import ServiceError, UsageError
from protocol.log.reader import LogReader, RawLogRecord

SESSIONS_PER_PASS = 100_000  # --loop: passes are not continuous, so each pass has its own session numbers
_REPEATED, _REPEATED_S = "every 5 s", 6.0  # `rate` in the table of topics; a little more than that
DEFAULT_TOPICS = tuple(name for name in topics.RECORDED if topics.TOPIC_OF_NAME[name].source == "gateway")


class BusReplay:
    """Publishes records on a zenoh session.  Use it as a context manager; the boards are alive on the bus within it.

    `rename` publishes the only board under another name, `site` all boards under another site.
    """

    def __init__(
        self,
        session: zenoh.Session,
        boards: Sequence[tuple[str, str]],
        *,
        rename: str | None = None,
        site: str | None = None,
    ) -> None:
        if rename is not None and len(boards) > 1:
            names = ", ".join(board for _, board in boards)
            raise UsageError(f"--as {rename}: the log has several boards: {names}", remedy="Choose one with --board")
        self._session = session
        self._rename, self._site = rename, site
        self._boards = boards
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared = ExitStack()
        self.session_offset = 0

    def __enter__(self) -> BusReplay:
        for site, board in self._boards:
            alive = topics.key(self._site or site, self._rename or board, topics.ALIVE)
            for reply in self._session.liveliness().get(alive, timeout=1.0):
                if reply.ok is not None:
                    raise ServiceError(
                        f"Board {alive.removesuffix('/alive')} is alive on this bus",
                        remedy="Replay under another name (--as NAME) or site (--as-site SITE), or stop its gateway",
                    )
            self._declared.enter_context(self._session.liveliness().declare_token(alive))
        return self

    def __exit__(self, *_: object) -> None:
        self._declared.close()

    def declare(self, keys: Iterable[tuple[str, str, str]]) -> None:
        """Announce (site, board, topic) ahead of the first message, so that subscribers are matched by then."""
        for site, board, topic in keys:
            self._publisher(site, board, topic)
            if topic in encoding.BATCH_OF:
                self._publisher(site, board, encoding.BATCH_OF[topic])

    def matched(self) -> bool:
        """Return whether an announced key has a subscriber."""
        return any(has_subscriber(publisher) for publisher in self._publishers.values())

    def send(self, record: RawLogRecord) -> None:
        """Publish one record."""
        data = record.data
        if self.session_offset:
            data = _with_session(record.topic, data, self.session_offset)
        self._publisher(record.site, record.board, record.topic).put(data, attachment=encoding.REPLAYED)
        if record.topic in encoding.BATCH_OF:
            batch, topic = encoding.batch(record.topic, [data]), encoding.BATCH_OF[record.topic]
            self._publisher(record.site, record.board, topic).put(batch, attachment=encoding.REPLAYED)

    def _publisher(self, site: str, board: str, topic: str) -> zenoh.Publisher:
        key = topics.key(self._site or site, self._rename or board, topic)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._declared.enter_context(
                self._session.declare_publisher(
                    key,
                    encoding=encoding.zenoh_encoding(topics.TOPIC_OF_NAME[topic].message),
                    # A replay is not live: it waits for slow subscribers, so that they get every message.
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
            )
            self._publishers[key] = publisher
        return publisher


def contents(reader: LogReader, *, topics_: Sequence[str], boards: Sequence[str] | None) -> list[tuple[str, str, str]]:
    """Return (site, board, topic) of the keys that a replay would send, in the order of appearance."""
    unique_keys: dict[tuple[str, str, str], None] = {}
    if all(scan.indexed for scan in reader.scans):
        keys = [channel.topic for scan in reader.scans for channel in scan.channels.values()]
        addresses = [address for address in map(topics.split, keys) if address is not None]
        unique_keys = dict.fromkeys(a for a in addresses if a[2] in topics_ and (boards is None or a[1] in boards))
    else:
        for record in reader.raw(topics_=topics_, boards=boards):
            unique_keys.setdefault((record.site, record.board, record.topic))
    return list(unique_keys)


def from_time(
    reader: LogReader, start_s: float, *, topics_: Sequence[str], boards: Sequence[str] | None, end_s: float | None
) -> Iterator[RawLogRecord]:
    """Yield the records from a time on; before them the newest of what is repeated, such as parameters and plant."""
    at_ns = reader.start_ns + round(start_s * 1e9)
    repeated = [topic.name for topic in topics.TOPICS if topic.name in topics_ and _REPEATED in topic.rate]
    before = reader.raw(topics_=repeated, boards=boards, start_s=max(0.0, start_s - _REPEATED_S), end_s=start_s)
    known = {record.key: record._replace(time_ns=at_ns) for record in before} if start_s > 0.0 else {}
    newest = sorted(known.values(), key=lambda record: record.topic != "parameters")  # it says that a pass begins
    records = reader.raw(topics_=topics_, boards=boards, start_s=start_s, end_s=end_s)
    for first in islice(records, 1):  # behind the end there is nothing
        yield from (*newest, first)
    yield from records


def _with_session(topic: str, data: bytes, offset: int) -> bytes:
    message: Message | None = encoding.parse(topics.TOPIC_OF_NAME[topic].message, data)
    if message is None or "session" not in message.DESCRIPTOR.fields_by_name:
        return data
    message.session += offset  # type: ignore[attr-defined]  # checked the line above
    return message.SerializeToString()
