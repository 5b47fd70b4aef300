"""Acts of a view in their threads: STOP waits for none of them, and gives up those that wait for its rig."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable

from gateway.views.dispatch import ACTS, FRESH_S, Dispatch, Wish
from protocol.bus import board51_pb2 as pb
from tests.patience import HANG_S

Act = Callable[[], pb.CommandReply]


class Busy:
    """A dispatch whose threads all wait for a board that does not answer, until `answer` is set."""

    def __init__(self) -> None:
        self.dispatch = Dispatch("page", lambda _: -math.inf)
        self.answer = threading.Event()
        self.begun = threading.Semaphore(0)
        self.waiting: list[asyncio.Task[pb.CommandReply]] = []

    def _unanswered(self) -> pb.CommandReply:
        self.begun.release()
        self.answer.wait(HANG_S)
        return pb.CommandReply(refused_by="link")

    async def begin(self) -> None:
        for _ in range(ACTS):
            self.waiting.append(asyncio.create_task(self.dispatch.act(Wish(board="dead"), self._unanswered)))
        for _ in range(ACTS):
            assert await asyncio.to_thread(self.begun.acquire, timeout=HANG_S)

    async def end(self) -> None:
        self.answer.set()
        await asyncio.gather(*self.waiting)


def accepted() -> pb.CommandReply:
    return pb.CommandReply(accepted=True)


def test_a_stop_waits_for_no_act_and_gives_up_what_waits_for_its_rig() -> None:
    async def play(stopped: str) -> list[pb.CommandReply]:
        busy, replies = Busy(), []
        await busy.begin()
        rigs = ("rig1", "rig2", "")  # the last concerns no rig
        waiting = [asyncio.create_task(busy.dispatch.act(Wish(board=rig), accepted)) for rig in rigs]
        await asyncio.sleep(0)  # they are in the queue

        reply = await asyncio.wait_for(busy.dispatch.stop([stopped], accepted), HANG_S)

        assert reply.accepted
        assert not any(task.done() for task in (*busy.waiting, *waiting)), "no thread is free, and STOP needs none"
        await busy.end()
        replies += await asyncio.gather(*waiting)
        replies.append(await busy.dispatch.act(Wish(board="rig1"), accepted))
        return replies

    single_rig, all_rigs = asyncio.run(play("rig1")), asyncio.run(play("*"))

    assert [reply.reason for reply in single_rig] == ["superseded-by-stop", "", "", ""]
    assert [reply.reason for reply in all_rigs] == ["superseded-by-stop", "superseded-by-stop", "", ""]


def test_a_stop_of_another_view_gives_up_what_came_before_it() -> None:
    stop_s = time.monotonic()
    dispatch = Dispatch("page", lambda board: stop_s if board == "rig1" else -math.inf)

    async def act(board: str, arrived_s: float) -> str:
        return (await dispatch.act(Wish(board=board, arrived_s=arrived_s), accepted)).reason

    assert asyncio.run(act("rig1", stop_s - 0.1)) == "superseded-by-stop"
    assert asyncio.run(act("rig1", stop_s + 0.1)) == ""
    assert asyncio.run(act("rig2", stop_s - 0.1)) == ""


def test_whether_an_act_is_late_is_judged_when_it_begins() -> None:
    async def play() -> list[str]:
        busy = Busy()
        await busy.begin()
        stale = Wish(board="rig1", arrived_s=time.monotonic() - FRESH_S)
        left = Wish(board="rig1", arrived_s=time.monotonic() + HANG_S)
        fresh = Wish(board="rig1", arrived_s=time.monotonic() + HANG_S)  # fresh however slow this machine is
        waiting = [asyncio.create_task(busy.dispatch.act(wish, accepted)) for wish in (stale, left, fresh)]
        await asyncio.sleep(0)
        left.has_left = True
        await busy.end()
        return [reply.reason for reply in await asyncio.gather(*waiting)]

    assert asyncio.run(play()) == ["not-fresh", "not-fresh", ""]


def test_the_date_of_an_act_is_that_of_its_arrival() -> None:
    wish = Wish(board="rig1", arrived_s=time.monotonic() - 2.0)

    age_s = (time.time_ns() - wish.issued_ns) * 1e-9

    assert 1.9 < age_s < 2.0 + HANG_S
