"""Limits of a client's subscriptions: shortest interval and largest number of items."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.event_objects import RefreshEndEvent, RefreshStartEvent
from asyncua.server.subscription_service import SubscriptionService

from gateway.views.opcua.items import MAX_INTERVAL_MS, Items

MIN_INTERVAL_MS = 20.0
MAX_ITEMS = 5_000  # monitored items of one subscription; eight boards have 1500 variables
_SERVER = ua.NodeId(ua.ObjectIds.Server)


class BoundedSubscriptions(SubscriptionService):  # type: ignore[misc]  # asyncua's class is untyped
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
        if math.isnan(interval_ms):
            interval_ms = MIN_INTERVAL_MS
        params.RequestedPublishingInterval = min(max(interval_ms, MIN_INTERVAL_MS), MAX_INTERVAL_MS)
        result = await super().create_subscription(params, callback, session_id, request_callback)
        subscription = self.subscriptions[result.SubscriptionId]
        subscription.monitored_item_srv = Items(subscription, self.aspace, self.periodic)
        return result

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create as many items as there is room for; the rest get BadTooManyMonitoredItems."""
        subscription = self.subscriptions.get(params.SubscriptionId)
        held = 0 if subscription is None else subscription.monitored_item_srv.held()
        room = max(0, MAX_ITEMS - held)
        surplus = len(params.ItemsToCreate) - room
        params.ItemsToCreate = params.ItemsToCreate[:room]
        results: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        for _ in range(surplus):
            refused = ua.MonitoredItemCreateResult()
            refused.StatusCode = ua.StatusCode(ua.StatusCodes.BadTooManyMonitoredItems)
            results.append(refused)
        return results

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
