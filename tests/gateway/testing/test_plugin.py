"""The pytest plugin, used as its users do: in a project of their own, by a pytest of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from tests.patience import HANG_S

EXAMPLE = Path(__file__).parent / "example_project"


def run_pytest(project: Path, *words: str) -> subprocess.CompletedProcess[str]:
    # The plugin by its name, others not at all: the same with and without an installation that knows the entry point.
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(Path.cwd())}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "gateway.testing", "-p", "no:cacheprovider", "-rA", *words]
    return subprocess.run(
        command, cwd=project, env=environment, capture_output=True, text=True, timeout=5 * HANG_S, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "passes"), [("test_my_controller.py", 4), ("test_my_scada.py", 4)])
def test_the_example_project_tests_its_own_code(name: str, passes: int, tmp_path: Path) -> None:
    shutil.copy(EXAMPLE / name, tmp_path)

    process = run_pytest(tmp_path)

    assert f"{passes} passed" in process.stdout, process.stdout + process.stderr
    assert process.returncode == 0


@pytest.mark.slow
def test_a_failing_test_fails_and_leaves_nothing_running(tmp_path: Path) -> None:
    (tmp_path / "test_wrong.py").write_text(
        "import os\n"
        "def test_wrong(board51_gateway):\n"
        "    gateway = board51_gateway()\n"
        "    print('process', gateway._process.pid)\n"
        "    assert gateway.boards == []\n"
        "def test_misspelt(board51_emulator):\n"
        "    board51_emulator(effects={'quadratic-rag': 1.0})\n"
    )

    process = run_pytest(tmp_path)

    assert "2 failed" in process.stdout
    assert "AssertionError" in process.stdout
    assert "quadratic-rag" in process.stdout
    pid = int(process.stdout.partition("process ")[2].split()[0])
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_who_uses_no_fixture_pays_for_nothing(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text(
        "import sys\n"
        "def test_own():\n"
        "    assert 'gateway.testing' in sys.modules\n"
        "    assert not {'zenoh', 'numpy', 'numba', 'serial', 'google.protobuf'} & set(sys.modules)\n"
    )

    process = run_pytest(tmp_path)

    assert "1 passed" in process.stdout, process.stdout


def test_an_installation_offers_the_plugin() -> None:
    offered = {entry.name: entry.value for entry in entry_points(group="pytest11")}

    assert offered.get("board51") == "gateway.testing", (
        "run `make setup`: the installation is older than pyproject.toml"
    )
