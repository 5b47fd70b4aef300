"""A configuration on which something could not rely does not compile, and the compiler names what."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from firmware.sim.avr.build import compile_image
from gateway.emulator.native.flags import SOURCES, flags
from protocol.errors import ServiceError
from tests.harness.firmware.avr_bench import skip_without_avr


@pytest.mark.parametrize(
    ("option", "file", "condition"),
    [
        ("B51_STATE_DEPTH=3U", "layout", "b51_four_states_wait"),
        ("B51_EVENT_DEPTH=200U", "layout", "b51_the_events_of_a_boot_wait"),
        ("B51_CAPTURE_SIZE=201U", "layout", "b51_the_samples_are_pairs"),
        ("B51_CAPTURE_SIZE=2002U", "layout", "b51_the_samples_can_be_asked_for"),
        ("B51_TICK_US=UINT32_C(3000)", "layout", "b51_a_second_is_whole_ticks"),
        ("B51_TICK_US=UINT32_C(8000)", "capture", "b51_the_first_sample_is_at_a_tick"),
        ("B51_COMMANDS_PER_TICK=0U", "layout", "b51_a_command_is_executed"),
    ],
)
def test_the_compiler_names_what_does_not_hold(option: str, file: str, condition: str) -> None:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    source = SOURCES / "core" / f"{file}.c"

    process = subprocess.run(
        [gcc, *flags("POSIX_FLAGS"), f"-D{option}", "-fsyntax-only", str(source)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip

    assert process.returncode != 0
    assert condition in process.stderr
    assert process.stderr.count("error:") == 1


def test_the_linker_keeps_room_for_the_stack(tmp_path: Path) -> None:
    skip_without_avr()

    with pytest.raises(ServiceError, match="avr-gcc fails"):
        compile_image(tmp_path / "avr.elf", options=("-UB51_CAPTURE_SIZE", "-DB51_CAPTURE_SIZE=206U"))
    compile_image(tmp_path / "avr.elf", options=("-UB51_CAPTURE_SIZE", "-DB51_CAPTURE_SIZE=202U"))
