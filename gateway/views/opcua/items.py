"""The monitored items of one subscription: which changes they report, and with which timestamps.

Rule 1: a deadband is relative to the last value sent, so that a slow drift is reported, too; a change of status is
        always reported (Part 4, 7.22.2).
Rule 2: no value or filter of a client raises an error: it would end the service for all clients.
"""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.server.monitored_item_service import MonitoredItemData, MonitoredItemService

from gateway.views.opcua.address_space.timestamps import stamped

VALUE = ua.AttributeIds.Value
Trigger = ua.DataChangeTrigger
_logger = logging.getLogger("gateway.opcua")


class Items(MonitoredItemService):  # type: ignore[misc]  # asyncua's class is untyped
    """asyncua's service for one subscription, with the timestamps asked for and filters as Part 4 has them."""

    _asked = ua.TimestampsToReturn.Source

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """One result for each."""
        self._asked = params.TimestampsToReturn
        results: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        return results

    async def _create_data_change_monitored_item(
        self, params: ua.MonitoredItemCreateRequest
    ) -> ua.MonitoredItemCreateResult:
        if not _fits(params.RequestedParameters, ua.DataChangeFilter):
            return _refused()
        return await super()._create_data_change_monitored_item(params)

    def _create_events_monitored_item(self, params: ua.MonitoredItemCreateRequest) -> ua.MonitoredItemCreateResult:
        if not _fits(params.RequestedParameters, ua.EventFilter) or params.RequestedParameters.Filter is None:
            return _refused()
        return super()._create_events_monitored_item(params)

    def modify_monitored_items(self, params: ua.ModifyMonitoredItemsParameters) -> list[ua.MonitoredItemModifyResult]:
        """One result for each, with what is served of what was asked for."""
        return [self._modified(item, params.TimestampsToReturn) for item in params.ItemsToModify]

    async def datachange_callback(self, handle: int, value: ua.DataValue, error: ua.StatusCode | None = None) -> None:
        """A value has been sampled: queue it where it is news."""
        if error is not None:
            await super().datachange_callback(handle, value, error)
            return
        mid = self._monitored_datachange[handle]
        data = self._monitored_items[mid]
        if data.mode == ua.MonitoringMode.Disabled or not is_news(data.mvalue.current_dvalue, value, data.filter):
            return
        data.mvalue.set_current_datavalue(value)
        of_value = data.read_value_id.AttributeId == VALUE
        shown = stamped(value, data.timestamps, datetime.now(UTC), of_value=of_value)
        event = ua.MonitoredItemNotification(ClientHandle=data.client_handle, Value=shown)
        await self.isub.enqueue_datachange_event(mid, event, data.queue_size)

    def of_events(self) -> dict[int, ua.NodeId]:
        """The items that get events, with the node that they listen at."""
        return {mid: node for node, mids in self._monitored_events.items() for mid in mids}

    async def send_event(self, event: Any, mid: int) -> None:
        """To one item, through its filter, whoever emits it."""
        await self._trigger_event(event, mid)

    async def _trigger_event(self, event: Any, mid: int) -> None:
        try:
            await super()._trigger_event(event, mid)
        except Exception as error:  # asyncua looks at the client's clauses now, and raises whatever comes of them
            _logger.warning("an item with strange clauses gets no events: %r", error)
            self._delete_monitored_items(mid)

    def held(self) -> int:
        """How many items there are."""
        return len(self._monitored_items)

    def _make_monitored_item_common(
        self, params: ua.MonitoredItemCreateRequest
    ) -> tuple[ua.MonitoredItemCreateResult, MonitoredItemData]:
        result, data = super()._make_monitored_item_common(params)
        data.timestamps = self._asked
        return result, data

    def _modified(
        self, item: ua.MonitoredItemModifyRequest, asked: ua.TimestampsToReturn
    ) -> ua.MonitoredItemModifyResult:
        result = ua.MonitoredItemModifyResult()
        data = self._monitored_items.get(item.MonitoredItemId)
        if data is None:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
            return result
        wanted = item.RequestedParameters
        if not _fits(wanted, type(data.filter) if data.filter is not None else ua.DataChangeFilter):
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
            return result
        data.timestamps, data.client_handle = asked, wanted.ClientHandle
        data.queue_size = result.RevisedQueueSize = self._revise_queue_size(wanted.QueueSize)
        result.RevisedSamplingInterval = self.isub.data.RevisedPublishingInterval
        if wanted.Filter is not None:
            data.filter = wanted.Filter
        return result


def _fits(asked: ua.MonitoringParameters, kind: Any) -> bool:
    """Whether its filter is of that kind or none; a null one becomes None.

    By the data type: asyncua decodes into classes that are not those of the same names in `ua`.
    """
    asked.Filter = asked.Filter or None
    return asked.Filter is None or getattr(asked.Filter, "data_type", None) == kind.data_type


def _refused() -> ua.MonitoredItemCreateResult:
    return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported))


def is_news(sent: ua.DataValue | None, value: ua.DataValue, asked: Any) -> bool:
    """Return whether to report `value` to a client after `sent`; `asked`: its DataChangeFilter, or None."""
    if sent is None or sent.StatusCode != value.StatusCode:
        return True
    trigger = asked.Trigger if asked is not None else Trigger.StatusValue
    band = asked.DeadbandValue if asked is not None and asked.DeadbandType == ua.DeadbandType.Absolute else 0.0
    # With a deadband, a time stamp alone is no news.
    if trigger == Trigger.StatusValueTimestamp and not band and sent.SourceTimestamp != value.SourceTimestamp:
        return True
    if trigger == Trigger.Status or sent.Value == value.Value:
        return False
    old, new = sent.Value.Value, value.Value.Value
    if band and isinstance(old, int | float) and isinstance(new, int | float):
        return bool(abs(new - old) > band)
    return True
