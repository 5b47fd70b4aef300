"""Keys and a guarded gateway are made once for all tests that do not change them: six RSA keys cost half a second."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gateway.access.folder import SecurityFolder
from tests.harness.gateway.access_peers import GuardedRig, guarded_rig, made_folder
from tests.harness.once import once


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SecurityFolder:
    """A plant with ana (engineer), ben (operator) and vic (viewer).  Not to be changed."""
    return SecurityFolder(once(tmp_path_factory, "keys", made_folder))


@pytest.fixture(scope="session")
def rig(keys: SecurityFolder, tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedRig]:
    """A gateway behind these keys."""
    with guarded_rig(keys, tmp_path_factory.mktemp("logs")) as running:
        yield running
