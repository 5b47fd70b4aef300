"""The samples of one board as an iterator, for a duration of the board's time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

from gateway.client.errors import NoSamplesError
from gateway.client.message_queue import MessageQueue
from gateway.client.values import Sample
from protocol.bus import board51_pb2 as pb


class SampleStream(Iterator[Sample]):
    """Iterator over samples as they arrive; `rig.samples()` makes it.

    It subscribes when it is made, so no sample is missed before the loop begins.
    """

    def __init__(self, queue: MessageQueue, board: str, duration_s: float, timeout_s: float) -> None:
        self._queue, self._board = queue, board
        self._left_s, self._timeout_s = duration_s, timeout_s
        self._last: Sample | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the subscription."""
        self._queue.close()

    @property
    def dropped(self) -> int:
        """Samples dropped because the loop was too slow."""
        return self._queue.dropped

    def __next__(self) -> Sample:
        state = None
        while not isinstance(state, pb.State):
            arrival = self._queue.take(self._timeout_s)
            if arrival is None:
                raise NoSamplesError(
                    f"No samples from {self._board} for {self._timeout_s:g} s",
                    remedy="Look at rig.status(): gateway, link or board is gone, or its stream is off",
                )
            state = arrival.message
        sample, last = Sample.of(state), self._last
        if last is not None and last.session == sample.session:
            self._left_s -= sample.t_s - last.t_s
        self._last = sample
        if self._left_s < 1e-6:  # s; less than a tick, more than rounding errors
            self.close()
            raise StopIteration
        return sample
