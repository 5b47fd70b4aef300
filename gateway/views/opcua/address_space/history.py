"""The last minutes of every tick-rate variable, in memory of fixed size, for HistoryRead.

Rule 1: a track is a ring of `rows`: one row for each interval of one topic, one column for each variable.
Rule 2: what is read is what subscribers got: the same values, stamps and status codes; a loss is a row, not a hole.
Rule 3: reading is bounded by MAX_VALUES per call; the rest comes with a continuation point.
Rule 4: an empty answer says why it is empty: nothing in that time, no history of this variable, no such variable.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua
from asyncua.server.history import HistoryManager, HistoryStorageInterface
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.timestamps import stamped
from gateway.views.opcua.address_space.values import data_value, datetime_of

MAX_VALUES = 10_000
S = ua.StatusCodes
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
        low, high = 0, self.count
        while low < high:
            middle = (low + high) // 2
            if self._stamps_ns[self._slot(middle)] < stamp_ns:
                low = middle + 1
            else:
                high = middle
        return low

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


class RingHistory(HistoryStorageInterface):  # type: ignore[misc]  # asyncua's class is untyped in part
    """asyncua's storage over tracks; filled by the boards' nodes directly, not through a subscription."""

    def __init__(self) -> None:
        super().__init__(MAX_VALUES)
        self._columns: dict[ua.NodeId, tuple[Track, int]] = {}

    def add(self, node: ua.NodeId, track: Track, column: int) -> None:
        """`node` is a column of `track`."""
        self._columns[node] = (track, column)

    def holds(self, node: ua.NodeId) -> bool:
        """Return whether there is a history of `node`."""
        return node in self._columns

    async def init(self) -> None:
        """Do nothing: there is nothing to open."""

    async def stop(self) -> None:
        """Do nothing: there is nothing to close."""

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """Values with start <= stamp <= end; backwards where start is absent or after end."""
        if node_id not in self._columns:
            return [], None
        track, column = self._columns[node_id]
        start, end = _bound(start), _bound(end)
        backwards = start is None or (end is not None and start > end)
        oldest, newest = (end, start) if backwards and start is not None else (start, end)
        first = 0 if oldest is None else track.find(_ns(oldest))
        after = track.count if newest is None else track.find(_ns(newest) + 1000)
        rows: Sequence[int] = range(first, after)
        if backwards:
            rows = rows[::-1]
        limit = min(nb_values or MAX_VALUES, MAX_VALUES)
        # asyncua hands the continuation point back as the start, which an absent start cannot be told from.
        more = track.stamp(rows[limit]) if len(rows) > limit and start is not None else None
        return [track.value(column, row) for row in rows[:limit]], more

    async def new_historized_node(self, node_id: ua.NodeId, period: timedelta | None, count: int = 0) -> None:
        """Unused: see `add`."""

    async def save_node_value(self, node_id: ua.NodeId, datavalue: ua.DataValue) -> None:
        """Unused: see `Track.append`."""

    async def new_historized_event(
        self, source_id: ua.NodeId, evtypes: list[Any], period: timedelta | None, count: int = 0
    ) -> None:
        """Events are in the log."""

    async def save_event(self, event: Any) -> None:
        """Do nothing: events are in the log."""

    async def read_event_history(
        self, source_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int, evfilter: Any
    ) -> tuple[list[Any], datetime | None]:
        """Return no events: they are in the log."""
        return [], None


class Historian(HistoryManager):  # type: ignore[misc]  # as above
    """asyncua's history service, which calls every answer good."""

    def __init__(self, server: InternalServer, storage: RingHistory) -> None:
        super().__init__(server)
        self._server, self._retained = server, storage
        self.set_storage(storage)

    async def read_history(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        """Return one result for each requested node."""
        results: list[ua.HistoryReadResult] = await super().read_history(params)
        return [
            self._checked(params, item.NodeId, result) for item, result in zip(params.NodesToRead, results, strict=True)
        ]

    def _checked(
        self, params: ua.HistoryReadParameters, node: ua.NodeId, result: ua.HistoryReadResult
    ) -> ua.HistoryReadResult:
        details, requested = params.HistoryReadDetails, params.TimestampsToReturn
        raw = isinstance(details, ua.ReadRawModifiedDetails) and not details.IsReadModified
        if node not in self._server.aspace:
            code = S.BadNodeIdUnknown
        elif not raw or not self._retained.holds(node):
            code = S.BadHistoryOperationUnsupported
        else:
            values = result.HistoryData.DataValues
            result.HistoryData.DataValues = [stamped(value, requested, value.ServerTimestamp) for value in values]
            if not values:
                result.StatusCode = ua.StatusCode(S.GoodNoData)
            return result
        return ua.HistoryReadResult(StatusCode=ua.StatusCode(code))


def _bound(moment: datetime | None) -> datetime | None:
    if moment is None or moment == _OPEN or moment.year < 1900:
        return None
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


def _ns(moment: datetime) -> int:
    delta = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return ((delta.days * 86400 + delta.seconds) * 1_000_000 + delta.microseconds) * 1000
