"""The last minutes of every tick-rate variable, in memory of fixed size, for HistoryRead.

Rule 1: a track is a ring of `rows`: one row for each interval of one topic, one column for each variable.
Rule 2: history has the values, stamps and status codes that subscribers got; a loss is a row, not a gap.
Rule 3: reading is bounded by MAX_VALUES per call; the rest comes with a continuation point.
Rule 4: an empty answer says why it is empty: nothing in that time, no history of this variable, no such variable.
"""

from __future__ import annotations

import time
from array import array
from bisect import bisect_left
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.server.history import HistoryManager
from asyncua.server.internal_server import InternalServer
from asyncua.ua.ua_binary import Primitives

from gateway.views.opcua.address_space.values import data_value, datetime_of, stamped

MAX_VALUES = 10_000
S = ua.StatusCodes
DateTime = Primitives.DateTime
_OPEN = ua.get_win_epoch()  # how a client says "no bound"


class Track:
    """Rows of one topic of one board."""

    def __init__(self, columns: int, rows: int) -> None:
        self.rows, self.columns = rows, columns
        self.count = 0
        self._head = 0
        self._stamps_ns = array("q", bytes(8 * rows))
        self._retained_ns = array("q", bytes(8 * rows))  # when the row came here: the server's timestamp
        self._values = [array("d", bytes(8 * rows)) for _ in range(columns)]
        self._codes = [array("L", bytes(array("L").itemsize * rows)) for _ in range(columns)]

    def append(self, stamp_ns: int, values: Sequence[float], codes: Sequence[int]) -> None:
        """Append a row, in the order of the columns; a full track drops its oldest row."""
        at = self._head
        self._stamps_ns[at], self._retained_ns[at] = stamp_ns, time.time_ns()
        for column, (value, code) in enumerate(zip(values, codes, strict=True)):
            self._values[column][at] = value
            self._codes[column][at] = code
        self._head = (at + 1) % self.rows
        self.count = min(self.count + 1, self.rows)

    def find(self, stamp_ns: int) -> int:
        """Return the number of rows older than `stamp_ns`."""
        return bisect_left(range(self.count), stamp_ns, key=lambda row: self._stamps_ns[self._slot(row)])

    def value(self, column: int, row: int) -> ua.DataValue:
        """Return the value in a row, counted from the oldest."""
        at = self._slot(row)
        value = data_value(
            self._values[column][at], ua.VariantType.Double, self._codes[column][at], self._stamps_ns[at]
        )
        value.ServerTimestamp = datetime_of(self._retained_ns[at])
        return value

    def stamp(self, row: int) -> datetime:
        """Return the source timestamp of a row."""
        return datetime_of(self._stamps_ns[self._slot(row)])

    def _slot(self, row: int) -> int:
        return (self._head - self.count + row) % self.rows


class RingHistory(HistoryManager):
    """asyncua's history service over tracks, which the boards' nodes fill.  Events are in the log."""

    def __init__(self, server: InternalServer) -> None:
        super().__init__(server)
        self._server = server
        self._columns: dict[ua.NodeId, tuple[Track, int]] = {}

    def add(self, node: ua.NodeId, track: Track, column: int) -> None:
        """`node` is a column of `track`."""
        self._columns[node] = (track, column)

    async def read_history(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Return one result for each requested node."""
        return [self._result(params, item) for item in params.NodesToRead]

    def _result(self, params: ua.HistoryReadParameters, item: ua.HistoryReadValueId) -> ua.HistoryReadResult:
        details = params.HistoryReadDetails
        if item.NodeId not in self._server.aspace:
            return ua.HistoryReadResult(StatusCode=ua.StatusCode(S.BadNodeIdUnknown))
        raw = isinstance(details, ua.ReadRawModifiedDetails) and not details.IsReadModified
        if not raw or item.NodeId not in self._columns:
            return ua.HistoryReadResult(StatusCode=ua.StatusCode(S.BadHistoryOperationUnsupported))
        # A continuation point is the start of the rest, so that the server keeps no state of it.
        start = DateTime.unpack(Buffer(item.ContinuationPoint)) if item.ContinuationPoint else details.StartTime
        values, more = self.read(item.NodeId, start, details.EndTime, details.NumValuesPerNode)
        stamps = params.TimestampsToReturn
        return ua.HistoryReadResult(
            StatusCode=ua.StatusCode(S.Good if values else S.GoodNoData),
            ContinuationPoint=DateTime.pack(more) if more else None,
            HistoryData=ua.HistoryData([stamped(value, stamps, value.ServerTimestamp) for value in values]),
        )

    def read(
        self, node: ua.NodeId, start: datetime | None, end: datetime | None, count: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """Return values with start <= stamp <= end, and where the rest begins.

        They come backwards where the start is absent or after the end.
        """
        track, column = self._columns[node]
        start, end = _bound(start), _bound(end)
        backwards = start is None or (end is not None and start > end)
        oldest, newest = (end, start) if backwards and start is not None else (start, end)
        first = 0 if oldest is None else track.find(_ns(oldest))
        after = track.count if newest is None else track.find(_ns(newest) + 1000)
        rows: Sequence[int] = range(first, after)
        if backwards:
            rows = rows[::-1]
        limit = min(count or MAX_VALUES, MAX_VALUES)
        # A client returns the continuation point as the start, which cannot be distinguished from an absent start.
        more = track.stamp(rows[limit]) if len(rows) > limit and start is not None else None
        return [track.value(column, row) for row in rows[:limit]], more


def _bound(moment: datetime | None) -> datetime | None:
    if moment is None or moment == _OPEN or moment.year < 1900:
        return None
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


def _ns(moment: datetime) -> int:
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
