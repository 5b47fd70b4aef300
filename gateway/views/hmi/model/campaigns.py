"""The campaigns of a rig, from their folders.

    DATA/campaigns/<board>-<date>-<time>/    recordings, campaign.toml, model.json of `identify`, acts.jsonl
                             .../diagnosis/  diagnosis.json, report.html, extended_model.json; of a diagnosis of live
                                             data its recordings, too
                             .../validation/ validation.json, report.html: the identified model on the judge recordings
                             .../bode/       bode.json, bode.html: frequency responses
                             .../comparison/ compare.json, compare.html of the latest two models
                             .../name.txt    what people call it

Rule 1: a name from a browser is looked up among those found, never joined to a path.
Rule 2: a campaign that failed or was interrupted is never shown in place of a finished one, unless the user chooses it.
"""

from __future__ import annotations

import json
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.views.hmi.library import LibraryFile
from protocol.campaign import load_plant
from protocol.errors import Board51Error, DataError
from protocol.files import parse_json, read_small

ACTS = "acts.jsonl"  # in the folder of a campaign: who did what, one line for each act
MAX_ACTS = 20
_TAIL_BYTES = 65_536  # of the end of the file that is read
MAX_CAMPAIGNS = 50  # the newest
MODEL, DIAGNOSIS, VALIDATION, BODE, COMPARISON = "model.json", "diagnosis", "validation", "bode", "comparison"
EXTENDED_MODEL = f"{DIAGNOSIS}/extended_model.json"
RESULT_FILES = {  # JSON of the `board51` commands
    "validation": f"{VALIDATION}/validation.json", "diagnosis": f"{DIAGNOSIS}/diagnosis.json",
    "comparison": f"{COMPARISON}/compare.json", "bode": f"{BODE}/bode.json",
}  # fmt: skip
RESULTS = (*RESULT_FILES, "design", "forecast")  # the last two of the newest design
RESULT_PAGES = {  # for people
    "validation": f"{VALIDATION}/report.html", "diagnosis": f"{DIAGNOSIS}/report.html",
    "comparison": f"{COMPARISON}/compare.html", "bode": f"{BODE}/bode.html",
}  # fmt: skip
TITLE, TITLE_LENGTH = "name.txt", 60
_NAME = re.compile(r"(?P<board>.+)-(?P<date>\d{8})-(?P<hour>\d{2})(?P<minute>\d{2})\d{2}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignFolder:
    """The folder of one campaign."""

    name: str
    path: Path
    board: str
    made: str  # for people
    title: str  # what people call it
    recordings: int
    left: tuple[str, ...]  # experiments that an interrupted run has not made
    quick: bool  # of its latest run
    investigation: bool  # an interrupted one
    acts: tuple[dict[str, str], ...]  # see acts_of

    def file(self, name: str) -> Path | None:
        """Return a file below the folder; None where it is absent."""
        path = self.path / name
        return path if path.is_file() else None

    def result(self, name: str) -> dict[str, Any]:
        """Return the content of one of RESULT_FILES; empty if it is missing or damaged."""
        return read_table(self.path / RESULT_FILES[name])

    @property
    def toml(self) -> Path | None:
        """Return the campaign.toml; None before the campaign has recorded anything."""
        recorded = sorted((self.path / DIAGNOSIS).glob("live-*/campaign.toml"))
        return self.file("campaign.toml") or (recorded[-1] if recorded else None)

    @property
    def interrupted(self) -> bool:
        """Return whether experiments or steps are left, so that it can be continued."""
        return bool(self.left) or self.investigation

    @property
    def plant_assumed(self) -> bool:
        """Return whether nobody stated its plant."""
        try:
            return self.toml is not None and load_plant(self.toml).assumed
        except Board51Error:  # `identify` says what is wrong with it
            return False


def board_of(name: str) -> str:
    """Return the board of a campaign's folder by its name; empty if it is not the name of a campaign."""
    match = _NAME.fullmatch(name)
    return match["board"] if match is not None else ""


def campaign_of(report: LibraryFile) -> str:
    """Return the name of the campaign of a report; empty if no folder in its path is a campaign."""
    return next((folder.name for folder in report.path.parents if board_of(folder.name)), "")


def rig_of(report: LibraryFile) -> str:
    """Return the board of the campaign of a report; empty if no folder in its path is a campaign."""
    return board_of(campaign_of(report))


def campaigns_of(root: Path, board: str) -> list[CampaignFolder]:
    """Return the campaigns of one board below `root`, the newest first."""
    try:
        names = sorted((path.name for path in root.iterdir() if path.is_dir() and not path.is_symlink()), reverse=True)
    except OSError:
        return []
    mine = [name for name in names if board_of(name) == board][:MAX_CAMPAIGNS]
    return [_campaign(root / name, board) for name in mine]


def choose(campaigns: list[CampaignFolder], name: str) -> CampaignFolder | None:
    """Return the campaign of that name; for an empty name the newest finished one, else the newest with recordings."""
    if name:
        return next((campaign for campaign in campaigns if campaign.name == name), None)
    recorded = [campaign for campaign in campaigns if campaign.toml is not None]
    return next((campaign for campaign in recorded if not campaign.interrupted), recorded[0] if recorded else None)


def find_campaign(root: Path, board: str, name: str) -> CampaignFolder | None:
    """Return the campaign of that name, or the newest for an empty name; None if there is none."""
    campaigns = campaigns_of(root, board)
    return next((campaign for campaign in campaigns if name in ("", campaign.name)), None)


def _campaign(path: Path, board: str) -> CampaignFolder:
    match = _NAME.fullmatch(path.name)
    assert match is not None  # board_of has said so
    date, run = match["date"], read_table(path / "run.json")
    journal = read_table(path / "investigation.json")
    left = run.get("left")
    return CampaignFolder(
        name=path.name,
        path=path,
        board=board,
        made=f"{date[:4]}-{date[4:6]}-{date[6:]} {match['hour']}:{match['minute']}",
        title=_title(path),
        recordings=sum(1 for _ in path.glob("*.mcap")) + sum(1 for _ in path.glob(f"{DIAGNOSIS}/live-*/*.mcap")),
        left=tuple(map(str, left)) if isinstance(left, list) else (),
        quick=run.get("quick") is True,
        investigation="ended" in journal and journal["ended"] is None,
        acts=acts_of(path),
    )


def read_table(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file; empty if it is missing or damaged."""
    try:
        return parse_table(read_small(path, remedy="Make it again"), where=str(path))
    except DataError:
        return {}


def parse_table(text: str, *, where: str) -> dict[str, Any]:
    """Return the object in a JSON text; empty if there is none."""
    try:
        table = parse_json(text, where=where)
    except DataError:
        return {}
    return table if isinstance(table, dict) else {}


def _title(path: Path) -> str:
    try:
        with (path / TITLE).open(encoding="utf-8", errors="replace") as stream:
            return stream.read(TITLE_LENGTH).strip()
    except OSError:
        return ""


def write_act(folder: Path, *, who: str, what: str) -> None:
    """Append a line.  Raises OSError where the folder cannot be written."""
    folder.mkdir(parents=True, exist_ok=True)
    line = json.dumps({"at": time.strftime("%Y-%m-%d %H:%M"), "who": who, "what": what})
    with (folder / ACTS).open("a", encoding="utf-8") as stream:
        stream.write(line + "\n")


def acts_of(folder: Path) -> tuple[dict[str, str], ...]:
    """The newest acts, in their order: `at` (for people), `who`, `what`; lines that are none are left out."""
    try:
        with (folder / ACTS).open("rb") as stream:
            stream.seek(max(0, stream.seek(0, 2) - _TAIL_BYTES))
            lines = stream.read().decode("utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    return tuple(act for act in map(_act, lines[-MAX_ACTS:]) if act is not None)


def _act(line: str) -> dict[str, str] | None:
    try:
        table = json.loads(line)
        return {name: str(table[name]) for name in ("at", "who", "what")}
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
