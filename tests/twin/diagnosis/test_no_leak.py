"""The code under test reads the campaign folder, itself and its libraries: nothing that knows what is hidden."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.trial import ROOT, clean_environment

# Its own code.  Not here: the emulator, the tests, everything else of the repository.
PRODUCT_PATHS = (ROOT / "board51.py", ROOT / "protocol", ROOT / "twin", ROOT / "__pycache__")
HOME = Path.home()
SYSTEM = (
    *(Path(p).resolve() for p in (sys.prefix, sys.base_prefix, sys.exec_prefix)),
    *(Path(p) for p in ("/usr", "/lib", "/lib64", "/etc", "/proc", "/sys", "/dev")),
    *(HOME / p for p in (".cache/matplotlib", ".config/matplotlib", ".fonts", ".local/share/fonts", ".cache/numba")),
)


def watched(command: list[str], tmp_path: Path) -> tuple[subprocess.CompletedProcess[str], list[tuple[str, str, str]]]:
    """Run it; what it touched as (event, r | w, path)."""
    log = tmp_path / "watch.log"
    folder = tmp_path / "watch"
    folder.mkdir()
    (folder / "sitecustomize.py").write_bytes((Path(__file__).parent / "sitecustomize.py").read_bytes())
    environment = clean_environment() | {"PYTHONPATH": str(folder), "BOARD51_WATCH_LOG": str(log)}
    environment |= {"TMPDIR": str(tmp_path / "scratch"), "PYTHONDONTWRITEBYTECODE": "1"}
    (tmp_path / "scratch").mkdir()
    child = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900, check=False)
    lines = [line.split("\t", 2) for line in log.read_text(encoding="utf-8").splitlines()]
    return child, [(event, mode, path) for event, mode, path in lines]


def leaks(touched: list[tuple[str, str, str]], allowed: tuple[Path, ...]) -> set[str]:
    """Return everything else that was touched: files, listed folders, other programs, connections."""
    allowed_paths = tuple(str(path.resolve()) for path in (*PRODUCT_PATHS, *SYSTEM, *allowed))
    leaked = set()
    for event, _, what in touched:
        if event in ("open", "os.listdir", "os.scandir", "glob.glob"):
            # A folder on the way to an import is listed by the import system: names, no contents.
            importing = event in ("os.listdir", "os.scandir") and what == str(ROOT)
            # An editable installation puts a name on sys.path that is no file; the import system tries it all the same.
            importing |= Path(what).name.startswith("__editable__.") and not Path(what).exists()
            if not importing and not any(what == path or what.startswith(path + os.sep) for path in allowed_paths):
                leaked.add(f"{event} {what}")
        elif not (event == "subprocess.Popen" and Path(what).resolve() == Path(sys.executable).resolve()):
            leaked.add(f"{event} {what}")
    return leaked


def run_on_a_hidden_campaign(tmp_path: Path, *arguments: str) -> tuple[subprocess.CompletedProcess[str], set[str]]:
    campaign, out = tmp_path / "hidden" / "campaign", tmp_path / "out"
    make_campaign(campaign, effects={"constant-force": 0.01}, seed=4, plant="independent", quick=True)
    (tmp_path / "hidden" / "truth.json").write_text('{"constant-force": 0.01}', encoding="utf-8")
    filled = [argument.format(campaign=campaign, out=out) for argument in arguments]
    child, touched = watched([sys.executable, *filled], tmp_path)
    assert any(path.startswith(str(campaign.resolve())) for _, _, path in touched), child.stderr
    allowed = (campaign, out, tmp_path / "scratch", tmp_path / "watch")
    return child, leaks(touched, allowed)


@pytest.mark.slow
def test_diagnose_reads_nothing_but_the_campaign_folder(tmp_path: Path) -> None:
    child, leaked = run_on_a_hidden_campaign(
        tmp_path, "-m", "board51", "diagnose", "{campaign}", "--out", "{out}", "--quick"
    )

    assert (tmp_path / "out" / "diagnosis.json").is_file(), child.stderr
    assert leaked == set()


@pytest.mark.slow
def test_identify_reads_nothing_but_the_campaign_folder(tmp_path: Path) -> None:
    child, leaked = run_on_a_hidden_campaign(tmp_path, "-m", "board51", "identify", "{campaign}", "--out", "{out}.json")

    assert child.returncode == 0, child.stderr
    assert leaked == {f"open {(tmp_path / 'out.json').resolve()}"}


@pytest.mark.parametrize(
    "peek",
    [
        "open(c + '/../truth.json').read()",
        "import os; os.listdir(c + '/..')",
        "import gateway.emulator.plant.effects",
        "import tests.harness.diagnose.draws",
        "import subprocess; subprocess.run(['cat', c + '/../truth.json'])",
        "import subprocess, sys; subprocess.run([sys.executable, '-c', 'open(\"' + c + '/../truth.json\")'])",
    ],
)
def test_whoever_peeks_is_caught(tmp_path: Path, peek: str) -> None:
    script = f"import sys; c = sys.argv[1]; open(c + '/campaign.toml').read(); {peek}"

    _, leaked = run_on_a_hidden_campaign(tmp_path, "-c", script, "{campaign}")

    assert leaked
