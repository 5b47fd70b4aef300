"""The subscriptions of clients: their limits, and their monitored items with what these report.

Rule 1: a deadband is relative to the last value sent, so that a slow drift is reported, too; a change of status is
        always reported (Part 4, 7.22.2).
Rule 2: the promised sampling interval is the one that is served: whole intervals of the server; those between are left
        out.  A change of status is never left out, nor a minimum or maximum: a spike would be lost.
Rule 3: no value or filter of a client raises an error: it would end the service for all clients.
"""

from __future__ import annotations

import logging
import math
import uuid
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.event_objects import RefreshEndEvent, RefreshStartEvent
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.monitored_item_service import MonitoredItemData, MonitoredItemService
from asyncua.server.subscription_service import SubscriptionService

from gateway.views.opcua.address_space.values import stamped

VALUE = ua.AttributeIds.Value
MAX_INTERVAL_MS = 3_600_000.0
Trigger = ua.DataChangeTrigger
_logger = logging.getLogger("gateway.opcua")
MIN_INTERVAL_MS = 20.0
MAX_ITEMS = 5_000  # monitored items of one subscription; eight boards have 1500 variables
_SERVER = ua.NodeId(ua.ObjectIds.Server)


class Items(MonitoredItemService):
    """asyncua's service for one subscription, with the timestamps asked for and filters as Part 4 has them."""

    _timestamps = ua.TimestampsToReturn.Source

    def __init__(
        self, subscription: InternalSubscription, space: AddressSpace, periodic: AbstractSet[ua.NodeId]
    ) -> None:
        super().__init__(subscription, space)
        self._periodic = periodic  # nodes with a value in each interval; all others send changes, as they come

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create items; return one result for each."""
        self._timestamps = params.TimestampsToReturn
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
        """Modify items; return one result for each, with the values that are served."""
        return [self._modified(item, params.TimestampsToReturn) for item in params.ItemsToModify]

    async def datachange_callback(self, handle: int, value: ua.DataValue, error: ua.StatusCode | None = None) -> None:
        """Queue a sampled value if it must be reported."""
        if error is not None:
            await super().datachange_callback(handle, value, error)
            return
        mid = self._monitored_datachange[handle]
        data = self._monitored_items[mid]
        sent = data.mvalue.current_dvalue
        if data.mode == ua.MonitoringMode.Disabled:
            return
        data.left_out += 1
        if sent is not None and sent.StatusCode == value.StatusCode and data.left_out < data.every:
            return
        data.left_out = 0
        if not is_news(sent, value, data.filter):
            return
        data.mvalue.set_current_datavalue(value)
        of_value = data.read_value_id.AttributeId == VALUE
        reported = stamped(value, data.timestamps, datetime.now(UTC), of_value=of_value)
        event = ua.MonitoredItemNotification(ClientHandle=data.client_handle, Value=reported)
        await self.isub.enqueue_datachange_event(mid, event, data.queue_size)

    def of_events(self) -> dict[int, ua.NodeId]:
        """Return the items that receive events, each with its node."""
        return {mid: node for node, mids in self._monitored_events.items() for mid in mids}

    async def send_event(self, event: Any, mid: int) -> None:
        """Send an event to one item, through its filter, whichever node emits it."""
        await self._trigger_event(event, mid)

    async def _trigger_event(self, event: Any, mid: int) -> None:
        try:
            await super()._trigger_event(event, mid)
        except Exception as error:  # asyncua looks at the client's clauses now, and raises whatever comes of them
            _logger.warning("an item with strange clauses gets no events: %r", error)
            self._delete_monitored_items(mid)

    def held(self) -> int:
        """Return the number of items."""
        return len(self._monitored_items)

    def _make_monitored_item_common(
        self, params: ua.MonitoredItemCreateRequest
    ) -> tuple[ua.MonitoredItemCreateResult, MonitoredItemData]:
        result, data = super()._make_monitored_item_common(params)
        data.timestamps = self._timestamps
        result.RevisedSamplingInterval = self._revise(data, params.RequestedParameters.SamplingInterval)
        return result, data

    async def trigger_datachange(self, handle: int, nodeid: ua.NodeId, attr: ua.AttributeIds) -> None:
        """Report the present value, of a new item or one that is enabled again; the intervals count from here."""
        data = self._monitored_items[self._monitored_datachange[handle]]
        data.left_out = data.every
        await super().trigger_datachange(handle, nodeid, attr)

    def _revise(self, data: MonitoredItemData, requested_ms: float) -> float:
        """Return the sampling interval that is served, and note every how many values it is (Part 4, 7.21)."""
        publishing_ms: float = self.isub.data.RevisedPublishingInterval
        data.every = data.left_out = 1
        node = data.read_value_id
        lowest = self.aspace.read_attribute_value(node.NodeId, ua.AttributeIds.MinimumSamplingInterval).Value
        interval_ms = float(lowest.Value or 0.0) if lowest is not None and node.AttributeId == VALUE else 0.0
        if not interval_ms:
            return publishing_ms
        if node.NodeId in self._periodic:
            sampling_ms = (
                publishing_ms if math.isnan(requested_ms) or requested_ms < 0 else min(requested_ms, MAX_INTERVAL_MS)
            )
            data.every = max(1, math.ceil(round(sampling_ms / interval_ms, 3)))
        return float(data.every * interval_ms)

    def _modified(
        self, item: ua.MonitoredItemModifyRequest, timestamps: ua.TimestampsToReturn
    ) -> ua.MonitoredItemModifyResult:
        result = ua.MonitoredItemModifyResult()
        data = self._monitored_items.get(item.MonitoredItemId)
        if data is None:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
            return result
        parameters = item.RequestedParameters
        if not _fits(parameters, type(data.filter) if data.filter is not None else ua.DataChangeFilter):
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
            return result
        data.timestamps, data.client_handle = timestamps, parameters.ClientHandle
        data.queue_size = result.RevisedQueueSize = self._revise_queue_size(parameters.QueueSize)
        result.RevisedSamplingInterval = self._revise(data, parameters.SamplingInterval)
        if parameters.Filter is not None:
            data.filter = parameters.Filter
        return result


def _fits(parameters: ua.MonitoringParameters, kind: Any) -> bool:
    """Return whether the filter is of that kind or None; a null filter becomes None.

    By the data type: asyncua decodes into classes that are not those of the same names in `ua`.
    """
    parameters.Filter = parameters.Filter or None
    return parameters.Filter is None or getattr(parameters.Filter, "data_type", None) == kind.data_type


def _refused() -> ua.MonitoredItemCreateResult:
    return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported))


def is_news(sent: ua.DataValue | None, value: ua.DataValue, filter_: Any) -> bool:
    """Return whether to report `value` to a client after `sent`; `filter_`: its DataChangeFilter, or None."""
    if sent is None or sent.StatusCode != value.StatusCode:
        return True
    trigger = filter_.Trigger if filter_ is not None else Trigger.StatusValue
    band = filter_.DeadbandValue if filter_ is not None and filter_.DeadbandType == ua.DeadbandType.Absolute else 0.0
    # With a deadband, a new time stamp alone is not a change.
    if trigger == Trigger.StatusValueTimestamp and not band and sent.SourceTimestamp != value.SourceTimestamp:
        return True
    if trigger == Trigger.Status or sent.Value == value.Value:
        return False
    old, new = sent.Value.Value, value.Value.Value
    if band and isinstance(old, int | float) and isinstance(new, int | float):
        return bool(abs(new - old) > band)
    return True


class BoundedSubscriptions(SubscriptionService):
    """Subscriptions with a shortest interval and a largest number of items."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.periodic: set[ua.NodeId] = set()  # nodes whose value is sent in each interval of the server

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: ua.NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription, with its interval revised to one that is served."""
        interval_ms = params.RequestedPublishingInterval
        params.RequestedPublishingInterval = min(max(MIN_INTERVAL_MS, interval_ms), MAX_INTERVAL_MS)  # not NaN
        result = await super().create_subscription(params, callback, session_id, request_callback)
        subscription = self.subscriptions[result.SubscriptionId]
        subscription.monitored_item_srv = Items(subscription, self.aspace, self.periodic)
        return result

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create as many items as there is room for; the rest get BadTooManyMonitoredItems."""
        subscription = self.subscriptions.get(params.SubscriptionId)
        room = max(0, MAX_ITEMS - (0 if subscription is None else subscription.monitored_item_srv.held()))
        surplus = len(params.ItemsToCreate) - room
        params.ItemsToCreate = params.ItemsToCreate[:room]
        results: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        refused = ua.StatusCode(ua.StatusCodes.BadTooManyMonitoredItems)
        return results + [ua.MonitoredItemCreateResult(StatusCode=refused) for _ in range(surplus)]

    async def refresh(self, number: int, item: int | None = None) -> int:
        """The conditions that are retained, to each event item that would have got them (Part 9, 5.5.7 and 5.5.8).

        With `item`, only that one of the subscription gets them.  Return a status code.
        """
        subscription = self.subscriptions.get(number)
        if subscription is None:
            return int(ua.StatusCodes.BadSubscriptionIdInvalid)
        items: Items = subscription.monitored_item_srv
        listening = items.of_events()
        if item is not None and item not in listening:
            return int(ua.StatusCodes.BadMonitoredItemIdInvalid)
        start, end = _bracket(RefreshStartEvent), _bracket(RefreshEndEvent)
        for mid, node in listening.items():
            if item in (None, mid):
                retained = [c for c in self._conditions.values() if node in (_SERVER, c.SourceNode)]
                for event in (start, *retained, end):
                    await items.send_event(event, mid)
        return int(ua.StatusCodes.Good)


def _bracket(kind: type) -> Any:
    event = kind(sourcenode=_SERVER, message="conditions that are retained", severity=100)
    event.EventId, event.SourceName = uuid.uuid4().bytes, "Server"
    event.Time = event.ReceiveTime = datetime.now(UTC)
    return event
