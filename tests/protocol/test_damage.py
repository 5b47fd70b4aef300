"""Damaged frames through the real decoder: none of them may come out as a good one.

The generator is the benchmark's: one to three flipped bits anywhere in a frame of any type, delimiters and COBS codes
too.
"""

from __future__ import annotations

import numpy as np
import pytest

from protocol.wire.codec import encode_body
from protocol.wire.decoder import BadFrame, State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import ROWS
from tests.bench import decoder as bench


def check_that_none_is_accepted(total: int, *, seed: int) -> None:
    accepted, causes = bench.count_accepted(total, seed)

    assert accepted == 0
    assert sum(causes.values()) >= total, "each damaged frame is reported; a flip can cut one in two, never hide it"


def test_thirty_thousand_damaged_frames_are_all_rejected() -> None:
    check_that_none_is_accepted(30_000, seed=1)


@pytest.mark.slow
def test_a_million_damaged_frames_are_all_rejected() -> None:
    """A decoder that leaves out one of the 16 bits of the CRC accepts 11 of these.

    Ten million are `python tests/bench/decoder.py`.
    """
    check_that_none_is_accepted(1_000_000, seed=2)


def test_every_damaged_frame_has_one_to_three_flipped_bits_and_all_bits_are_hit() -> None:
    rng = np.random.default_rng(3)
    good = np.frombuffer(bench.random_frame(rng, ROWS[0]), np.uint8)

    stream = bench.damage(rng, np.repeat(good[None, :], 5_000, axis=0))

    frames = np.frombuffer(stream, np.uint8).reshape(5_000, -1)
    assert not frames[:, [0, -1]].any()
    flipped = np.unpackbits(frames[:, 1:-1] ^ good, axis=1)
    assert set(flipped.sum(axis=1).tolist()) == {1, 2, 3}
    assert flipped.any(axis=0).all()


def test_a_flip_of_any_single_bit_of_any_message_is_rejected() -> None:
    rng = np.random.default_rng(0)
    ping = encode_frame(encode_body("PING", id=1))
    for row in ROWS:
        frame = bench.random_frame(rng, row)
        for bit in range(8 * len(frame)):
            damaged = bytearray(frame)
            damaged[bit // 8] ^= 1 << bit % 8

            *bad, last = StreamDecoder().feed(bytes(damaged) + ping)

            assert [event for event in bad if not isinstance(event, BadFrame)] == [], (row.name, bit)
            assert last == StreamDecoder().feed(ping)[0]


def test_the_baseline_of_the_benchmark_decodes_the_same_states() -> None:
    rng = np.random.default_rng(4)
    (state,) = (row for row in ROWS if row.name == "STATE")
    stream = bench.noisy(rng, [bench.random_frame(rng, state) for _ in range(500)])

    decoded = [event._asdict() for event in StreamDecoder().feed(stream) if isinstance(event, State)]

    assert len(decoded) > 400
    assert bench.FirstTry().feed(stream) == decoded
