"""The firmware's core, compiled as a careful engineer would: a warning is an error."""

from __future__ import annotations

from functools import partial

import pytest

from gateway.emulator.native.build import compile_to
from gateway.emulator.native.flags import flags
from tests.harness.firmware.core import Core
from tests.harness.gateway.board_host import skip_without_compiler
from tests.harness.once import once

WARNINGS = flags("WARNINGS", "POSIX_WARNINGS")


@pytest.fixture(scope="session")
def core(tmp_path_factory: pytest.TempPathFactory) -> Core:
    """The functions of the core."""
    skip_without_compiler()
    return Core(once(tmp_path_factory, "core.so", partial(compile_to, options=WARNINGS)))
