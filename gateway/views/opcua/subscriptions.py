"""What a client may ask of a subscription: everything at 1 ms becomes a bounded service."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.server.subscription_service import SubscriptionService

MIN_INTERVAL_MS = 20.0
MAX_INTERVAL_MS = 3_600_000.0
MAX_ITEMS = 5_000  # monitored items of one subscription; eight boards have 1500 variables


class BoundedSubscriptions(SubscriptionService):  # type: ignore[misc]  # asyncua's class is untyped
    """Subscriptions with a shortest interval and a largest number of items."""

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: ua.NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """With the interval revised to what is served."""
        asked_ms = params.RequestedPublishingInterval
        if math.isnan(asked_ms):
            asked_ms = MIN_INTERVAL_MS
        params.RequestedPublishingInterval = min(max(asked_ms, MIN_INTERVAL_MS), MAX_INTERVAL_MS)
        return await super().create_subscription(params, callback, session_id, request_callback)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """As many as there is room for; BadTooManyMonitoredItems for the rest."""
        subscription = self.subscriptions.get(params.SubscriptionId)
        items = {} if subscription is None else subscription.monitored_item_srv._monitored_items  # noqa: SLF001  # nowhere else
        held = len(items)
        room = max(0, MAX_ITEMS - held)
        surplus = len(params.ItemsToCreate) - room
        params.ItemsToCreate = params.ItemsToCreate[:room]
        results: list[ua.MonitoredItemCreateResult] = await super().create_monitored_items(params)
        for _ in range(surplus):
            refused = ua.MonitoredItemCreateResult()
            refused.StatusCode = ua.StatusCode(ua.StatusCodes.BadTooManyMonitoredItems)
            results.append(refused)
        return results
