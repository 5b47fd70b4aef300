"""Each rule of the page holds for the firmware in Python and for the one in C."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness.gateway.board_host import FIRMWARES, Host, skip_without_compiler


@pytest.fixture(params=FIRMWARES, scope="module")
def each_firmware(request: pytest.FixtureRequest) -> Iterator[str]:
    """Every `Host` of the module has a board with this firmware."""
    kind: str = request.param
    if kind == "c":
        skip_without_compiler()
    before, Host.make = Host.make, FIRMWARES[kind]
    yield kind
    Host.make = before
