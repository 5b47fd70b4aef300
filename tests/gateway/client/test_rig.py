"""A client of a live rig, on the shipped emulator through a real gateway and real zenoh."""

from __future__ import annotations

import inspect
import math
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gateway.client import (
    CommandNotDeliveredError,
    CommandRefusedError,
    Mode,
    NoSamplesError,
    OperatingPoint,
    Rig,
    read_log,
)
from gateway.client.connection import BusBoard, open_bus
from gateway.client.message_queue import MessageQueue
from gateway.emulator.serve import Emulator
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Plant
from protocol.errors import ServiceError, UsageError
from tests.harness.gateway.gateway_peers import gateway_and_client, gateway_config
from tests.patience import HANG_S


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with Emulator() as board:
        config = gateway_config(board.urls[0], host_loss="keep")  # a busy machine may be late; no flight ends by that
        with gateway_and_client(config):
            yield config.zenoh.listen[0]


@pytest.fixture
def rig(endpoint: str) -> Iterator[Rig]:
    with Rig("rig", connect=endpoint, timeout_s=HANG_S / 12) as rig:
        rig.stop()
        yield rig
        rig.stop()


def test_a_reference_is_followed_and_the_flight_comes_as_arrays(rig: Rig) -> None:
    rig.set_reference(0.003)
    rig.set_mode("closed-loop")
    rig.read(1.0)

    begun = rig.set_reference(0.0035)
    flight = rig.read(1.0)

    assert len(flight) == 500
    assert flight.x_m.shape == flight.t_s.shape == (500,)
    assert set(flight.mode) == {Mode.CLOSED_LOOP}
    assert flight.x_ref_m[flight.tick > begun.tick] == pytest.approx(0.0035, abs=2e-6)
    assert flight.x_m[-100:].mean() == pytest.approx(0.0035, abs=1e-4)
    assert flight.to_dict()["i_c_a"] is flight.i_c_a


def test_samples_come_one_by_one_without_a_gap_from_the_call_on(rig: Rig) -> None:
    stream = rig.samples(0.2)
    first = rig.ping().tick  # while nobody takes them

    samples = list(stream)

    assert samples[0].tick <= first
    assert len(samples) == 100
    assert all(b.tick - a.tick == 1 + b.lost_before for a, b in pairwise(samples))
    assert samples[0].mode is Mode.IDLE
    assert stream.dropped == 0


def test_a_loop_that_is_left_ends_its_subscription(rig: Rig) -> None:
    count = 0
    stream = rig.samples()
    waiting = stream._queue._waiting
    for _ in stream:
        count += 1
        if count == 3:
            break
    del stream
    rig.ping()
    left = len(waiting._messages)
    rig.read(0.1)

    assert len(waiting._messages) == left


def test_a_slow_reader_loses_the_oldest_samples_and_is_told_how_many(rig: Rig) -> None:
    stream = rig.samples(capacity=10)
    rig.read(0.1)

    sample = next(stream)

    assert stream.dropped >= 30
    assert next(stream).tick > sample.tick
    stream.close()


def test_every_command_of_the_interface_has_a_method_that_a_board_accepts(rig: Rig) -> None:
    parameters = rig.parameters()
    point = OperatingPoint(i_c_a=parameters.i_0_a, x_m=parameters.x_0_m, u_c_v=parameters.u_0_v)

    rig.set_gains(list(parameters.gains), point)
    rig.set_stream(2)
    rig.set_stream(1)
    rig.set_host_loss("keep", timeout_s=1.0)
    with pytest.raises(CommandRefusedError, match="not-confirmed"):
        rig.set_plant(Plant(name="rig", mass_kg=8e-3, travel_m=5.7e-3, x_max_m=5.7e-3, gravity_m_s2=10.0))
    rig.set_plant(Plant(name="rig", mass_kg=8e-3, travel_m=5.7e-3, x_max_m=5.7e-3, gravity_m_s2=9.81))
    assert rig.plant_card().plant.mass_kg == 8e-3
    rig.mark("here")
    rig.acknowledge("divergence-x", comment="seen")
    rig.shelve("divergence-x", 600.0, comment="known")
    rig.ping()
    rig.set_mode(Mode.OPEN_LOOP)
    rig.excite("rectangle", amplitude=0.2, offset=0.4, period_s=0.1, duration_s=1.0)
    rig.read(0.1)  # until a state shows the mode, the gateway cannot end an excitation without a jump
    rig.excite("none")
    rig.stop()

    methods = {"set_mode", "set_reference", "capture"} | {
        name for name, _ in inspect.getmembers(Rig, inspect.isfunction)
    }
    assert {field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields} <= methods
    assert {field.name for field in pb.TwinCommand.DESCRIPTOR.oneofs_by_name["what"].fields} <= methods


def test_a_capture_is_the_answer_of_the_coil_to_a_step(rig: Rig) -> None:
    rig.set_mode("open-loop")

    capture = rig.capture(u_from_v=0.0, u_to_v=1.0, duration_s=0.02, pre_s=0.004)

    assert capture.i_c_a.shape == capture.t_s.shape == (500,)
    assert capture.sample_time_s == pytest.approx(40e-6)
    assert capture.t_s[100] == 0.0
    assert capture.i_c_a[capture.t_s < 0].mean() == pytest.approx(0.0, abs=5e-3)
    assert capture.i_c_a[-50:].mean() == pytest.approx(0.297, rel=0.02)


def test_a_refusal_says_who_why_and_what_to_do(rig: Rig) -> None:
    with pytest.raises(CommandRefusedError, match="set reference was refused by the gateway") as refused:
        rig.set_reference(0.1)

    assert (refused.value.reason, refused.value.refused_by) == ("out-of-range", "gateway")
    assert refused.value.remedy


def test_what_cannot_be_a_command_is_refused_before_it_is_sent(rig: Rig) -> None:
    for wrong in (
        lambda: rig.set_mode("fast"),
        lambda: rig.set_reference(math.nan),
        lambda: rig.set_gains([1.0], OperatingPoint(i_c_a=0.6, x_m=3e-3, u_c_v=2.0)),
        lambda: rig.excite("chirp", amplitude=1.0),
        lambda: rig.excite("step", duration_s=0.0),
        lambda: rig.set_stream(-1),
        lambda: rig.mark("\x1b[2J"),
        lambda: rig.messages("weather"),
    ):
        with pytest.raises(UsageError):
            wrong()


def test_a_repeated_command_is_not_executed_twice(rig: Rig) -> None:
    command = pb.Command(mark=pb.Mark(text="once"))

    first = rig.send(command)
    again = rig.send(command)

    assert first.accepted
    assert again == first


def test_nobody_answers_for_a_board_that_is_not_there(endpoint: str) -> None:
    with Rig("elsewhere", connect=endpoint) as rig:
        with pytest.raises(CommandNotDeliveredError, match="No gateway answered") as lost:
            rig.ping()
        with pytest.raises(NoSamplesError, match="No samples from board51/elsewhere"):
            rig.read(1.0, timeout_s=0.2)
        with pytest.raises(ServiceError, match="No status"):
            rig.status(timeout_s=0.2)
        with pytest.raises(ServiceError, match="No twin answers"):
            rig.use_model(Path(__file__))

    assert lost.value.command.id
    assert lost.value.command.issued_ns


def mode_now(endpoint: str) -> Mode:
    with Rig("rig", connect=endpoint) as other:
        return next(other.samples(timeout_s=HANG_S)).mode


def test_an_exception_stops_what_the_rig_has_moved(rig: Rig, endpoint: str) -> None:
    def control() -> None:
        with Rig("rig", connect=endpoint) as mine:
            mine.set_mode("closed-loop")
            raise ValueError("my controller diverged")

    with pytest.raises(ValueError, match="my controller diverged") as error:
        control()

    assert mode_now(endpoint) is Mode.IDLE
    assert error.value.__notes__ == ["board51/rig was stopped because of this."]


def test_an_exception_of_who_only_looks_drops_no_ball(rig: Rig, endpoint: str) -> None:
    rig.set_mode("closed-loop")

    def look() -> None:
        with Rig("rig", connect=endpoint) as other:
            other.read(0.1)
            other.mark("a remark moves nothing")
            raise ValueError("my plot failed")

    with pytest.raises(ValueError, match="my plot failed"):
        look()

    assert mode_now(endpoint) is Mode.CLOSED_LOOP


def test_a_block_that_ends_well_leaves_the_ball_flying(rig: Rig, endpoint: str) -> None:
    with Rig("rig", connect=endpoint) as other:
        other.set_mode("closed-loop")

    assert mode_now(endpoint) is Mode.CLOSED_LOOP


def test_stop_goes_out_from_a_closed_rig_and_beside_a_reader(rig: Rig, endpoint: str) -> None:
    rig.set_mode("closed-loop")
    Rig("rig", connect=endpoint).stop()
    assert mode_now(endpoint) is Mode.IDLE

    rig.set_mode("closed-loop")
    reader = threading.Thread(target=lambda: rig.read(0.3))
    reader.start()
    rig.stop()
    reader.join(HANG_S)
    assert mode_now(endpoint) is Mode.IDLE


def test_a_rig_that_is_not_open_says_so(endpoint: str) -> None:
    rig = Rig("rig", connect=endpoint)
    with pytest.raises(UsageError, match="not open"):
        rig.ping()

    with rig:
        rig.ping()
    with pytest.raises(UsageError, match="not open"):
        rig.ping()
    rig.close()


def test_a_recording_holds_what_was_read_and_reads_back_equal(rig: Rig, tmp_path: Path) -> None:
    with rig.record(tmp_path / "new" / "logs", prefix="flight") as recording:
        samples = rig.read(0.5)
        rig.status()

    logged = recording.samples()

    assert [file.name.startswith("flight-") for file in recording.files] == [True]
    assert recording.stats.dropped == 0
    held = np.isin(logged.tick, samples.tick)
    assert held.sum() == len(samples)
    for name, values in samples.to_dict().items():
        np.testing.assert_array_equal(logged.to_dict()[name][held], values)
    assert len(read_log(recording.files[0], board="rig")) == len(logged)


def test_a_recording_ends_with_its_rig(endpoint: str, tmp_path: Path) -> None:
    with Rig("rig", connect=endpoint) as rig:
        recording = rig.record(tmp_path)
        rig.read(0.1)

    assert len(recording.samples()) > 0


def test_messages_of_any_topic_come_typed(rig: Rig) -> None:
    events = rig.messages("event", timeout_s=HANG_S)
    rig.mark("look here")

    texts = (event.text for event in events if isinstance(event, pb.Event) and event.name == "mark")

    assert "look here" in next(texts)


def test_a_closed_feed_hears_nothing_more(endpoint: str) -> None:
    with open_bus(endpoint) as session:
        with MessageQueue(BusBoard(session, "board51", "rig"), ["state"]) as feed:
            assert feed.take(HANG_S) is not None
        while feed.take(0.05) is not None:
            pass

        assert feed.take(0.1) is None


ENDINGS = {
    "exception": "raise RuntimeError('of the user')",
    "interrupt": "os.kill(os.getpid(), signal.SIGINT); time.sleep(60)",
    "exit": "sys.exit(3)",
    "end": "pass",
    "iterating": "stream = rig.samples(); next(stream); events = rig.messages('event'); raise RuntimeError('user')",
    "thread": "threading.Thread(target=lambda: [Rig('rig', connect=rig.connect).open().record('b'), 1 / 0]).start()",
    "working": "threading.Thread(target=lambda: print(len(rig.read(0.5)), 'samples after the end of main')).start()",
}
CODES = {"interrupt": -signal.SIGINT, "exit": 3, "end": 0, "thread": 0, "working": 0}


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_program_with_an_open_rig_ends_and_its_recording_is_complete(
    endpoint: str, tmp_path: Path, ending: str
) -> None:
    program = f"""
import os, signal, sys, threading, time
from gateway.client import Rig
signal.signal(signal.SIGINT, signal.default_int_handler)
rig = Rig("rig", connect={endpoint!r}).open()
rig.record("logs")
rig.read(0.2)
{ENDINGS[ending]}
"""
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, check=False
    )

    assert process.returncode == CODES.get(ending, 1), process.stderr
    assert ending != "working" or process.stdout == "250 samples after the end of main\n"
    files = list(tmp_path.glob("*/*.mcap"))
    assert files
    for file in files:
        assert file.read_bytes().endswith(b"\x89MCAP0\r\n")  # closed in order
    assert len(read_log(next(tmp_path.glob("logs/*.mcap")))) >= 100


@pytest.mark.slow
def test_a_test_run_that_leaves_a_rig_open_ends(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "test_users.py").write_text(
        f"from gateway.client import Rig\n\n\ndef test_it():\n    rig = Rig('rig', connect={endpoint!r}).open()\n"
        "    rig.record('logs')\n    rig.read(0.2)\n    raise RuntimeError('of the user')\n",
        encoding="utf-8",
    )

    process = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "test_users.py"],
        cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, check=False,
    )  # fmt: skip

    assert process.returncode == 1, process.stdout
    assert "of the user" in process.stdout
    (file,) = tmp_path.glob("logs/*.mcap")
    assert file.read_bytes().endswith(b"\x89MCAP0\r\n")
