"""Draw a set of cases "name the cause": folders of recordings, and their truths in one sealed file.

    DIR/case-01/   campaign.toml, names.csv, recordings as CSV with units in their headers
    DIR/manifest.json   SHA-256 of every file of the cases and of truth.json
    DIR/truth.json      what is hidden; its owner publishes it after the answers

Rule 1: the rigs are the second and the third plant: no line of them is shared with the twin.
Rule 2: the seeds of the cases are drawn from that of the set, so neighbours in the order say nothing of each other.
Rule 3: who knows the seed of the set can draw its truths.  A contest takes a secret one.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gateway.emulator.plant.effects import EFFECTS
from protocol.errors import DataError, UsageError
from tests.harness.diagnose.draws import INVISIBLE, Hidden, Part, draw_hidden, in_the_data, record_hidden
from tests.harness.diagnose.hidden_campaign import Grounded, PlantName, draw_rig
from tests.harness.truth.flights import floor_m

# Of ten cases.  `knock-out` and `gateway` need a program that is told about them.
MIX: tuple[Part, ...] = ("causes", "nulls", "forms", "outside", "composites")
MIX += ("causes", "nulls", "forms", "outside", "causes")
NO_CAUSE, OTHER = "nothing", "other"
NAMES = tuple(sorted(EFFECTS.keys() - INVISIBLE))
PLACES = ("force", "current", "position", "input", "time")
_LOOP_PARTS = {"amplifier": "input", "force": "force", "motion": "force", "timing": "time"}
_OUTSIDE = {
    "current": "current",
    "second": "input",
    "sensor": "position",
    "lateral": "position",
    "bit": "position",
    "supply": "input",
    "loose": "input",
}
_HEADER = {"t": "t_s", "u_c": "u_c_V", "i_c": "i_c_A", "x": "x_m", "x_ref": "x_ref_m"}
_DRAW, _ATTEMPTS = 33, 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """The hidden truth of a case."""

    case: str
    part: str
    seed: int
    names: tuple[str, ...]  # that an answer should give: of the list, `nothing` or `other`
    hidden: dict[str, float]  # strength by name, also of what the list lacks
    places: tuple[str, ...]
    floor_m: float  # error of x 20 ms ahead that a right model leaves


def place_of(name: str) -> str:
    """The part of the loop that an effect belongs to, also one that the list lacks."""
    if name not in EFFECTS:
        return _OUTSIDE.get(name.split("-")[0], "force")
    if EFFECTS[name].family == "sensing":
        return "current" if name.startswith("current-sensor") else "position"
    return _LOOP_PARTS[EFFECTS[name].family]


def draw_set(folder: Path, *, seed: int, count: int, part: str | None = None, quick: bool = False) -> None:
    """Write the cases, the manifest and the truths.

    Raises:
        UsageError: an unknown part, or the folder is not empty.
    """
    if part is not None and part not in MIX:
        raise UsageError(f"There is no part {part!r} of truths", remedy=f"Choose from {', '.join(dict.fromkeys(MIX))}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is not an empty folder", remedy="Name a new folder with --out")
    rng = np.random.default_rng([_DRAW, seed])
    parts = [part or MIX[n % len(MIX)] for n in range(count)]
    truths = [
        _draw_case(folder, f"case-{n:02d}", parts[index], rng, quick)
        for n, index in enumerate(rng.permutation(count).tolist(), 1)
    ]
    sealed = {"seed": seed, "quick": quick, "cases": [asdict(truth) for truth in truths]}
    (folder / "truth.json").write_text(json.dumps(sealed, indent=1) + "\n", encoding="utf-8")
    manifest = {"format": 1, "sha256": {path: _digest(folder / path) for path in _files(folder)}}
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")


def load_truths(folder: Path) -> tuple[Truth, ...]:
    """The truths of a set whose files are those of the manifest.

    Raises:
        DataError: a file is absent, unreadable or not that of the manifest.
    """
    try:
        expected: dict[str, str] = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["sha256"]
        cases: Any = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["cases"]
        changed = [path for path, digest in expected.items() if _digest(folder / path) != digest]
        truths = tuple(Truth(**case | {key: tuple(case[key]) for key in ("names", "places")}) for case in cases)
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise DataError(f"{folder} is not a set of cases ({problem})", remedy="Draw one with --draw") from None
    if changed:
        raise DataError(f"{folder / changed[0]} is not the file of manifest.json", remedy="Take the published set")
    return truths


def write_case(folder: Path, hidden: Hidden, *, quick: bool = False) -> None:
    """Write what an entry gets: nothing in it, its names or its times depends on what is hidden but the readings.

    Raises:
        Grounded: the ball does not fly with these effects.
    """
    record_hidden(folder, hidden, quick=quick)
    for path in sorted(folder.glob("*.csv.gz")):
        header, _, rows = gzip.decompress(path.read_bytes()).decode().partition("\n")
        names = ",".join(_HEADER[name.strip('"')] for name in header.strip().split(","))
        path.with_suffix("").write_text(f"{names}\n{rows}", encoding="utf-8")
        path.unlink()
    campaign = folder / "campaign.toml"
    lines = []
    for line in campaign.read_text(encoding="utf-8").replace(".csv.gz", ".csv").splitlines():
        lines.append(line)
        if line.startswith("use ="):
            columns = "t_s u_c_V i_c_A".split() if "amplifier-step" in lines[-2] else list(_HEADER.values())
            lines.append("columns = { " + ", ".join(f'{k} = "{v}"' for k, v in _HEADER.items() if v in columns) + " }")
    campaign.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with (folder / "names.csv").open("w", encoding="utf-8", newline="") as file:
        rows_of_names = [(name, place_of(name), EFFECTS[name].description) for name in NAMES]
        csv.writer(file).writerows([("name", "place", "what it does"), *rows_of_names])
    for path in (*folder.iterdir(), folder):
        os.utime(path, (0, 0))


def _draw_case(folder: Path, case: str, part: Part, rng: np.random.Generator, quick: bool) -> Truth:
    for _ in range(_ATTEMPTS):
        hidden = draw_hidden(int(rng.integers(2**31)), part)
        rig: PlantName = "textbook" if part == "forms" or (part == "nulls" and rng.random() < 0.5) else "independent"
        hidden = replace(hidden, plant=rig)
        with tempfile.TemporaryDirectory(prefix="draw-") as scratch:
            try:
                # An effect that changes no recording is no question.
                if INVISIBLE & hidden.effects.keys() or (
                    part == "causes" and not in_the_data(hidden, Path(scratch), quick=quick)
                ):
                    continue
                write_case(folder / case, hidden, quick=quick)
            except Grounded:
                continue
        return _truth(folder / case, hidden)
    raise DataError(f"{case}: none of {_ATTEMPTS} draws of {part} flies", remedy="Give another --seed")


def _truth(case: Path, hidden: Hidden) -> Truth:
    # Some forms have an effect that is not on the list.
    effects = [name if name in NAMES else OTHER for name in hidden.effects]
    names: Sequence[str] = [OTHER] if hidden.outside else effects or [NO_CAUSE]
    strengths = {**hidden.effects, **hidden.outside}
    # The twin's model has the effect by the same formula on the second plant, and the forms by none.
    formula = {} if hidden.form else hidden.effects
    return Truth(
        case=case.name,
        part=hidden.part,
        seed=hidden.seed,
        names=tuple(names),
        hidden=strengths,
        places=tuple(sorted({place_of(name) for name in strengths})),
        floor_m=floor_m(case, draw_rig(hidden.seed, hidden.plant), formula),  # type: ignore[arg-type]  # no gateway here
    )


def _files(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
