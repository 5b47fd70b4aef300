"""An installation without extras: the gateway runs, and a command that needs more says in one line what to install."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sysconfig
import tomllib
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import board51
from gateway.emulator.serve import Emulator
from gateway.processes.command import listens
from tests.harness.gateway.gateway_peers import wait_for
from tests.harness.ports import free_port
from tests.patience import HANG_S

ROOT = Path(__file__).parents[2]
INSTALLED = Path(sysconfig.get_path("purelib"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WITHOUT = [
    (["opcua"], "opcua"),
    (["hmi"], "web"),
    (["gateway", "--board", "rig1=/dev/null", "--opcua"], "opcua"),
    (["gateway", "--board", "rig1=/dev/null", "--hmi"], "web"),
    (["emulate", "--tcp", "127.0.0.1:0"], "emulator"),
    (["campaign", "run", "folder", "--board", "rig1"], "campaign"),
    (["import", "run.csv", "-o", "run.mcap"], "export"),
    (["export", "run.mcap", "-o", "run.csv"], "export"),
    (["logs", "archive", ".", "--to", "s3://plant"], "s3"),
    (["logs", "fetch", "s3://plant/run.mcap"], "s3"),
    (["twin"], "twin"),
    (["identify", "campaign.toml"], "twin"),
    (["design", "model.json"], "twin"),
    (["export-model", "model.json", "--to", "fmu"], "twin"),
    (["validate", "campaign.toml", "--model", "model.json", "--out", "v"], "twin"),
    (["compare", "ce152", "inteco"], "twin"),
    (["what-if", "run.csv", "--model", "ce152", "--gains", "c.json"], "twin"),
    (["bode", "model.json", "campaign.toml"], "twin"),
    (["predict", "model.json", "run.csv", "--horizon", "10", "--out", "p.csv"], "twin"),
    (["diagnose", "campaign.toml", "--out", "d"], "twin"),
    (["plot", "run.mcap", "--out", "p.png"], "twin"),
    (["compile"], "twin"),
    (["demo"], "twin"),
    (["investigate", "rig1"], "twin"),
    (["start", "--emulated"], "all"),
    (["bench", "identify"], "all"),
]


def _closure(requirements: list[str]) -> set[str]:
    """Names of all distributions that pip would install for them."""
    names: set[str] = set()
    pending = [Requirement(text) for text in requirements]
    while pending:
        requirement = pending.pop()
        if requirement.name in names:
            continue
        names.add(requirement.name)
        for extra in ("", *requirement.extras):
            for text in distribution(requirement.name).requires or ():
                further = Requirement(text)
                if further.marker is None or further.marker.evaluate({"extra": extra}):
                    pending.append(further)
    return names


def _environment(folder: Path, requirements: list[str]) -> Path:
    """A virtual environment with these and what they need, linked from the one that runs the tests; its Python."""
    venv.create(folder, symlinks=True, with_pip=False)
    packages = folder / "lib" / INSTALLED.parent.name / "site-packages"
    for name in _closure(requirements):
        for top in {file.parts[0] for file in distribution(name).files or ()} - {"..", "__pycache__"}:
            link = packages / top
            if not link.is_symlink():
                link.symlink_to(INSTALLED / top)
    return folder / "bin" / "python"


CAMPAIGN = """
[plant]
name = "rig"
mass_kg = 8.28e-3
travel_m = 5.7e-3
[[recording]]
file = "run.csv"
kind = "free"
use = "fit"
"""


def _words(*words: object) -> list[str]:
    return ["-m", "board51", *map(str, words)]


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with the core dependencies alone."""
    return _environment(tmp_path_factory.mktemp("core"), PROJECT["dependencies"])


def _run(python: Path, words: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [python, *words], cwd=cwd, env=surroundings, capture_output=True, text=True, timeout=HANG_S, check=False
    )


def test_the_gateway_needs_no_extra(core: Path, tmp_path: Path) -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with Emulator(boards=1) as emulator:
        words = _words("gateway", "--board", f"rig1={emulator.urls[0]}", "--listen", endpoint, "--log-dir", "logs")
        surroundings = {**os.environ, "PYTHONPATH": str(ROOT)}
        gateway = subprocess.Popen([core, *words], cwd=tmp_path, env=surroundings)
        try:
            wait_for(lambda: listens(port), "the router of the gateway")
            watched = _run(
                core,
                _words("watch", "--connect", endpoint, "--topic", "state", "--count", 20, "--timeout", HANG_S),
                tmp_path,
            )
            stopped = _run(core, _words("send", "rig1", "stop", "--connect", endpoint), tmp_path)
        finally:
            gateway.send_signal(signal.SIGTERM)
            code = gateway.wait(HANG_S)
    (log,) = (tmp_path / "logs").glob("*.mcap")

    process = _run(core, _words("info", log), tmp_path)

    assert watched.returncode == 0, watched.stderr
    assert stopped.returncode == 0, stopped.stderr
    assert code == 0
    assert process.returncode == 0, process.stderr
    assert "rig1" in process.stdout


def test_a_board_is_tested_without_an_extra(core: Path, tmp_path: Path) -> None:
    with Emulator(boards=1) as emulator:
        words = _words("selftest", "--board", emulator.urls[0], "--only", "identity", "--only", "converters", "--quick")

        process = _run(core, words, tmp_path)

    assert process.returncode == 0, process.stderr
    assert "with the extra 'web'" in process.stdout
    assert len(list((tmp_path / "logs").iterdir())) == 1


EACH = """
import contextlib, io, json, sys
import board51
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
        code = board51.main(words)
    print(json.dumps([code, said.getvalue()]))
"""


def test_a_command_without_its_extra_says_what_to_install(core: Path, tmp_path: Path) -> None:
    (tmp_path / "model.json").write_bytes((ROOT / "twin" / "model" / "ce152.json").read_bytes())
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    (tmp_path / "run.csv").write_text("t,u_c,i_c,x\n0,0,0,0\n0.002,0,0,0\n")

    process = _run(core, ["-c", EACH, json.dumps([words for words, _ in WITHOUT])], tmp_path)

    assert process.returncode == 0, process.stderr
    for (words, extra), line in zip(WITHOUT, process.stdout.splitlines(), strict=True):
        code, message = json.loads(line)
        assert (code, message.count("\n")) == (2, 1), (words, message)
        assert f"pip install 'board51[{extra}]'" in message, words
        assert extra in PROJECT["optional-dependencies"]


def test_every_command_that_needs_an_extra_is_tried_above() -> None:
    assert {words[0] for words, _ in WITHOUT} - {"gateway", "logs"} == set(board51.EXTRAS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extra", "packages"),
    [
        ("opcua", ["gateway.views.opcua"]),
        ("web", ["gateway.views.hmi"]),
        ("emulator", ["gateway.emulator"]),
        ("campaign", ["gateway.campaign"]),
        ("export", ["gateway.record"]),
        ("s3", ["gateway.record.archive"]),
        ("twin", ["twin"]),
    ],
)
def test_an_extra_has_all_that_its_part_imports(extra: str, packages: list[str], tmp_path: Path) -> None:
    python = _environment(tmp_path / "env", [*PROJECT["dependencies"], *PROJECT["optional-dependencies"][extra]])
    code = (
        "import importlib, pkgutil\n"
        f"for name in {packages}:\n"
        "    package = importlib.import_module(name)\n"
        "    for module in pkgutil.walk_packages(package.__path__, name + '.'):\n"
        "        importlib.import_module(module.name)\n"
    )

    process = _run(python, ["-c", code], tmp_path)

    assert process.returncode == 0, process.stderr
