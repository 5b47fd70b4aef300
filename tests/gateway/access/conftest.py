"""Keys are made once for all tests that do not change them: six RSA keys cost half a second."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.access.folder import SecurityFolder
from tests.gateway.access.access_peers import made_folder


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SecurityFolder:
    """A plant with ana (engineer), ben (operator) and vic (viewer).  Not to be changed."""
    path: Path = tmp_path_factory.mktemp("plant") / "keys"
    return made_folder(path)
