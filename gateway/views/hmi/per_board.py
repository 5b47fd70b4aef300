"""Keeps one thing of every board of a feed, whether or not somebody looks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Generic, TypeVar

from gateway.views.board_feed import BoardFeed
from gateway.views.feed import Feed

T = TypeVar("T")


class PerBoard(Generic[T]):
    """A thing of each board.

    Args:
        feed: of one site.
        make: makes it of a board.
    """

    def __init__(self, feed: Feed, make: Callable[[BoardFeed], T]) -> None:
        self._feed, self._make = feed, make
        self._things: dict[str, tuple[BoardFeed, T]] = {}

    def of(self, board: BoardFeed) -> T:
        """Return that of a board, from the first look on."""
        known = self._things.get(board.name)
        if known is None or known[0] is not board:  # a board that was removed comes back as another one
            known = self._things[board.name] = board, self._make(board)
        return known[1]

    async def follow(self, period_s: float, do: Callable[[T], object] = lambda _: None) -> None:
        """Look for new boards, and do something with that of each; runs until it is cancelled."""
        while True:
            for board in self._feed.board_feeds():
                do(self.of(board))
            await asyncio.sleep(period_s)
