"""Everything that reads bytes from outside, given valid input made wrong: an error that names it, or a result.

BOARD51_FUZZ_EXAMPLES=20000 pytest -n0 tests/system/test_hostile_input.py     other examples, and more of them
"""

from __future__ import annotations

import struct
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.emulator.plant.secret import open_sealed
from gateway.record.summary import as_text, summarise
from protocol.bus import board51_pb2 as pb
from protocol.errors import Board51Error
from protocol.wire.framing import cobs_decode, encode_frame
from tests.harness import mutations
from tests.harness.gateway.board_host import FIRMWARES
from tests.harness.gateway.lossy_line import LossyRig
from tests.harness.hostile_files import READERS, Reader, envelope_of
from tests.harness.hostile_messages import COMMANDS, fuzzed, message, usual_messages, write_log
from twin.readers.campaign import read_flight

chances = st.randoms(use_true_random=False)


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_a_file_made_wrong_is_read_or_named(reader: Reader, tmp_path: Path) -> None:
    path = tmp_path / reader.file

    @fuzzed
    @given(chance=chances)
    def read(chance: Random) -> None:
        path.write_bytes(reader.make(chance, tmp_path / f"scratch-{reader.file}"))
        try:
            reader.read(path)
        except Board51Error as error:
            named = any(name in str(error) for name in (str(tmp_path), *reader.names))
            if not named:
                raise AssertionError("an error that names nothing") from error

    read()


# What was found, made small.
FINDINGS = {
    "a law that is a list": ("gains", b'{"law": []}'),
    "a gain that no double holds": ("gains", b'law = "pid"\ngains = [1, 2, 1' + b"0" * 400 + b"]\n"),
    "a run without a plant": ("run", b'{"format": 1, "identity": {}, "lift_off_v": null, "recordings": {}}'),
    "a run with another plant": (
        "run",
        b'{"format": 1, "identity": {"plant": {"": 1}}, "lift_off_v": null, "recordings": {}}',
    ),
    "a carriage return in a line": ("table, twin", b"t,u_c,i_c,x\n0.0,1,1,1\r2\n0.002,1,1\n"),
    "a matrix without its shape": (
        "matrix, twin",
        b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<IIIIII8x", 14, 24, 6, 8, 6, 0),
    ),
}


@pytest.mark.parametrize(("reader", "content"), FINDINGS.values(), ids=FINDINGS)
def test_what_was_found_is_named(reader: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / READERS[reader].file
    path.write_bytes(content)

    with pytest.raises(Board51Error):
        READERS[reader].read(path)


@pytest.mark.parametrize(
    "content", [b"7", b"[]", b'{"effects": []}', b'{"effects": {"a": "b"}}', b'{"effects": {"a": 1e999}}']
)
def test_a_file_that_was_sealed_with_no_effects_is_named(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "sealed.json"
    path.write_bytes(envelope_of(content))

    with pytest.raises(Board51Error):
        open_sealed(path)


def test_values_of_a_newer_version_and_absurd_times_are_read(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    messages = usual_messages()
    for _, entry in messages:
        if isinstance(entry, pb.State):
            entry.mode = 7  # type: ignore[assignment]  # as a newer gateway may write
        elif isinstance(entry, pb.CaptureRecord):
            entry.sample_time_s = 1e308
    write_log(path, messages)

    summary = as_text(summarise(path))

    assert "7" in summary
    assert len(read_flight(path).t) == 40


@fuzzed
@given(chance=chances)
def test_every_command_is_answered_once_and_by_no_error_of_ours(chance: Random) -> None:
    rig = LossyRig(FIRMWARES["python"], seed=0, loss=0.0)
    rig.run(60)
    command = message(chance, chance.choice(COMMANDS))
    payload = command.SerializeToString()
    replies: list[pb.CommandReply] = []

    rig.send_bytes(payload if chance.randrange(4) else mutations.binary(chance, payload), replies)
    rig.run(200)

    assert len(replies) == 1
    assert replies[0].reason != "internal-error", replies[0]


@fuzzed
@given(chance=chances)
def test_a_board_that_lies_with_a_right_crc_stops_nothing(chance: Random) -> None:
    def lie(data: bytes) -> bytes:
        body = cobs_decode(data.strip(b"\x00"))
        assert body is not None
        return encode_frame(mutations.binary(chance, body[:-2])[:48] or b"\x01") if chance.randrange(8) == 0 else data

    rig = LossyRig(FIRMWARES["python"], seed=0, loss=0.0, divider=1)
    rig.from_board.spoil = lie

    rig.run(200)
