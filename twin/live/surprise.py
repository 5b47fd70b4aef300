"""The surprise of the live twin: rms of its one-step innovations, before and after another model.

Rule: only what the twin itself calls valid, and after a hand-over only ticks that the new model answered.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse
from protocol.bus.identity import Identity
from twin.mirror.bus.client import hand_over
from twin.mirror.bus.handover import Belief

SPAN_S = 3.0
SAMPLES = 1000
PATIENCE_S = 15.0  # the twin settles after a hand-over


@dataclass(frozen=True, slots=True)
class Surprise:
    """Rms of the innovations; NaN where there was none."""

    x_m: float
    i_c_a: float
    samples: int

    def __str__(self) -> str:
        if not self.samples:
            return "none (the ball does not fly)"
        return f"x {self.x_m * 1e6:.3g} um, i_c {self.i_c_a * 1e3:.3g} mA rms over {self.samples} samples"


def hand_over_and_compare(
    session: zenoh.Session,
    belief: Belief,
    *,
    site: str,
    board: str,
    endpoints: tuple[str, ...],
    identity: Identity | None = None,
) -> tuple[bool, list[str]]:
    """Hand `belief` to the twin of the board; whether it was taken, and what to tell.

    Raises:
        ServiceError: no twin answers.
    """
    messages: deque[pb.Divergence] = deque(maxlen=50_000)

    def arrived(sample: zenoh.Sample) -> None:
        if (message := parse(pb.Divergence, sample.payload.to_bytes())) is not None:
            messages.append(message)

    subscriber = session.declare_subscriber(topics.key(site, board, "twin/divergence"), arrived)
    try:
        # Innovations of the present model come first: without them there is nothing to compare with.
        time.sleep(SPAN_S)
        answers = hand_over(belief, site=site, board=board, endpoints=endpoints, identity=identity)
        lines = [f"{site}/{answer}" for answer in answers]
        if not all(answer.reply.accepted for answer in answers):
            return False, lines
        tick = answers[0].reply.tick
        before = surprise([answer for answer in list(messages) if answer.tick < tick])
        deadline, after = time.monotonic() + PATIENCE_S, surprise([])
        # Until there are enough, not for a fixed time: how long the twin settles depends on the model.
        while after.samples < SAMPLES and time.monotonic() < deadline:
            time.sleep(0.1)
            after = surprise([answer for answer in list(messages) if answer.tick >= tick])
    finally:
        subscriber.undeclare()
    return True, [*lines, f"innovation before: {before}", f"innovation after:  {after}"]


def surprise(messages: list[pb.Divergence]) -> Surprise:
    """Return the rms of the valid innovations."""
    valid = [message for message in messages if message.innovation_valid]
    n = len(valid)
    if not n:
        return Surprise(math.nan, math.nan, 0)
    return Surprise(
        math.sqrt(sum(message.innovation_x_m**2 for message in valid) / n),
        math.sqrt(sum(message.innovation_i_c_a**2 for message in valid) / n),
        n,
    )
