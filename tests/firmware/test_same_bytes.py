"""The firmware in C against the model in Python: a random host, line, rig and faults get the same bytes of both.

Each kind of rule has its own directed test too, on both firmwares (tests/gateway/emulator): chance rarely meets an
interval of a second.
"""

from __future__ import annotations

import pytest

from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.plant.levitation import EmulatedPlant
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.messages import ROWS, EventCode, Reason
from tests.harness.firmware.random_host import Traffic, play
from tests.harness.gateway.board_host import Bench, Host, frame, skip_without_compiler
from tests.harness.protocol.port import take_output

MINUTE = 30_000  # ticks
EVERYTHING = (
    {row.name for row in ROWS if not row.to_board and row.name != "STATE"}
    | {code.name for code in EventCode}
    | {reason.name for reason in Reason}
)


@pytest.fixture(autouse=True)
def _compiled() -> None:
    skip_without_compiler()


@pytest.mark.slow
def test_a_minute_of_anything_gives_the_same_bytes() -> None:
    runs = [play(seed, MINUTE // 4) for seed in range(19, 23)]

    assert names(runs) == EVERYTHING


@pytest.mark.slow
def test_five_minutes_of_anything_give_the_same_bytes() -> None:
    """These seeds reach every branch of the C core that half an hour from 100 on reaches (gcov)."""
    runs = [play(seed, MINUTE) for seed in (109, 110, 116, 117, 120)]

    assert names(runs) == EVERYTHING


@pytest.mark.sample
@pytest.mark.parametrize("first", [100, 106])
def test_half_an_hour_of_anything_gives_the_same_bytes(first: int) -> None:
    runs = [play(first + n, 5 * MINUTE) for n in range(3)]

    assert sum(run.ticks for run in runs) == 15 * MINUTE
    assert names(runs) == EVERYTHING


def test_both_fly_the_emulated_rig_along_the_same_path() -> None:
    effects = {"quadratic-drag": 1.0, "lost-samples": 0.05}
    plants = [EmulatedPlant(effects=effects, seed=3) for _ in range(2)]
    outputs: list[bytes] = []
    for make, plant in zip((Firmware, NativeFirmware), plants, strict=True):
        host = Host(plant, board=make(plant))
        host.request("SET_MODE", mode=1)
        host.request("CAPTURE", u_from=300, u_to=1700, pre=50, count=400)
        host.run(30)
        host.request("READ_CAPTURE", index=32)
        host.request("SET_MODE", mode=2)
        for x_ref in (2034, 2600, 1500):
            host.request("SET_REFERENCE", x_ref=x_ref)
            host.run(400)
        host.request(
            "EXCITE", shape=4, target=1, amplitude=60, offset=1500, period=7, period_end=1, seed=77, duration=500
        )
        host.run(600)
        outputs.append(repr((host.states, host.events, host.answers)).encode())

    assert outputs[0] == outputs[1]
    assert (plants[0].x_m, plants[0].v_m_s, plants[0].i_c_a) == (plants[1].x_m, plants[1].v_m_s, plants[1].i_c_a)


class Ramp(Bench):
    """Each look at the current is another one, so that no sample passes for its neighbour."""

    def sense(self) -> tuple[float, float]:
        self.i_a = (self.i_a + 0.0123) % 1.5
        return super().sense()


@pytest.mark.parametrize("count", [1, 2, 33, 34, 37])
def test_a_block_from_any_sample_on_is_the_same_and_has_nothing_of_an_older_capture(count: int) -> None:
    blocks: list[list[bytes]] = []
    for make in (Firmware, NativeFirmware):
        bench = Ramp()
        host = Host(bench, board=make(bench))
        for size in (60, count):
            host.request("CAPTURE", u_from=0, u_to=0, pre=0, count=size)
            host.run(20)
        blocks.append([host.request("READ_CAPTURE", index=n).bytes("samples") for n in range(count)])

    assert blocks[0] == blocks[1]
    assert len(set(blocks[0])) == count


def test_a_transmitter_that_takes_a_byte_at_a_time_gets_whole_frames_and_the_newest_state_first() -> None:
    board = NativeFirmware(Bench())
    take_output(board)
    board.feed(frame("HELLO", id=1, session=1, version_min=1, version_max=1))
    board.tick()
    received = board.take_frame(1) + board.take_frame(1)  # of the STATE
    for _ in range(2):
        board.tick()
        received += b"".join(board.take_frame(1) for _ in range(20))
    received += b"".join(iter(lambda: board.take_frame(7), b""))

    events = StreamDecoder().feed(received)

    kinds = [event.sequence if isinstance(event, State) else getattr(event, "name", event) for event in events]
    assert kinds == [0, 1, 2, "IDENTITY"]


def test_a_reset_waits_for_the_last_byte_of_its_ack() -> None:
    board = NativeFirmware(Bench())
    board.feed(frame("HELLO", id=1, session=1, version_min=1, version_max=1) + frame("SET_STREAM", id=2, divider=0))
    board.tick()
    take_output(board)
    board.feed(frame("RESET", id=3))
    board.tick()

    board.take_frame(5)
    board.tick()
    waited = board.next_tick
    rest = board.take_frame()
    board.tick()

    assert waited == 3
    assert len(rest) == 12 - 5
    assert board.next_tick == 0


def names(runs: list[Traffic]) -> set[str]:
    """Every answer, event and reason of the runs."""
    return set().union(*(run.names for run in runs))
