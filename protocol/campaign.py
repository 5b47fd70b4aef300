"""A campaign: the known data of a plant, the controller that ran on the board, and the recordings of the plant.

`Campaign` shows the format of `campaign.toml`.  `parse` reads a text, `load` reads a file or its folder.  The
recordings themselves are not opened here.

Rule 1: an error names file, key and value, and says what to write instead.  An unknown key is an error.
Rule 2: the key states the unit.  A value that must be in another unit (a travel of 5.7 m) is refused.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field

from protocol.checked import Keys, Number, RuleError, checked, key
from protocol.errors import ConfigError, DataError, quoted
from protocol.files import parse_toml, read_small
from protocol.plant import GRAVITY_M_S2 as GRAVITY_M_S2
from protocol.plant import Plant as Plant
from protocol.plant import refuse_impossible, with_defaults
from protocol.units import UNITS, unit_of_name

Channel = Literal["t", "u_c", "i_c", "x", "x_ref"]
Kind = Literal["amplifier-step", "sawtooth", "prbs", "closed-loop", "equilibria", "free"]
Use = Literal["fit", "judge"]
Law = Literal["lqi", "pid"]

CHANNELS: tuple[Channel, ...] = get_args(Channel)
KINDS: tuple[Kind, ...] = get_args(Kind)
Pair = Annotated[tuple[Number, Number], Field(description="[raw, value]")]  # of a look-up table


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint(Keys):
    """The operating point of the controller, eq. (13)."""

    i_c_a: Number
    x_m: Number
    u_c_v: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller(Keys):
    """The control law of the closed-loop recordings: `[controller]`, eq. (16)-(19)."""

    kind: Law
    gains: tuple[Number, Number, Number, Number]
    operating_point: OperatingPoint


def _not_zero(scale: float) -> float:
    if scale == 0.0:
        raise RuleError(" = 0 makes every value equal", remedy="Give the SI value of one unit")
    return scale


def _rising(table: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    for number, (before, pair) in enumerate(pairwise(table), 2):
        if pair[0] <= before[0]:
            raise RuleError(f" {number} = {list(pair)} does not rise", remedy="Write the pairs with rising raw values")
    return table


@dataclass(frozen=True, slots=True, kw_only=True)
class Column(Keys):
    """The source column of a channel and its conversion to SI units: value = offset + scale * table(raw).

    The table is interpolated linearly, and extrapolated linearly beyond its ends.
    """

    column: Annotated[str, Field(min_length=1)]
    scale: Annotated[Number, AfterValidator(_not_zero)] = 1.0
    offset: Number = 0.0
    table: Annotated[
        tuple[Pair, ...], Field(min_length=2, description="[raw, value] pairs"), AfterValidator(_rising)
    ] = ()

    def convert(self, raw: float) -> float:
        """Convert one raw value to SI units."""
        return self.offset + self.scale * (self._look_up(raw) if self.table else raw)

    def extrapolates(self, raw: float) -> bool:
        """Return whether `convert` extrapolates the table at `raw`."""
        return bool(self.table) and not self.table[0][0] <= raw <= self.table[-1][0]

    def _look_up(self, raw: float) -> float:
        right = bisect_right(self.table, raw, key=lambda point: point[0])
        # The first and the last segment serve for what lies beyond them.
        right = min(max(right, 1), len(self.table) - 1)
        (x0, y0), (x1, y1) = self.table[right - 1], self.table[right]
        return y0 + (y1 - y0) * ((raw - x0) / (x1 - x0))


def _in_si(columns: object) -> object:
    """Refuse a column whose name ends with a unit other than the channel's SI unit, unless it has a scale."""
    for channel, spec in columns.items() if isinstance(columns, dict) else ():
        column = spec.get("column") if isinstance(spec, dict) else spec
        scaled = isinstance(spec, dict) and ("scale" in spec or "table" in spec)
        unit = unit_of_name(column, channel) if isinstance(column, str) and channel in UNITS and not scaled else None
        if unit is not None:
            si = UNITS[channel]
            raise RuleError(
                f" = {quoted(column)} is in {unit[0]} by its name, {channel} is in {si}",
                remedy=f"Give it scale = {unit[1]:g}, or scale = 1.0 if its values are in {si} despite its name",
                key=channel,
            )
    return columns


def _named(spec: object) -> object:
    if isinstance(spec, str):
        return {"column": spec}
    if not isinstance(spec, dict | Column):
        raise RuleError(
            f" = {quoted(spec)} is not a column",
            remedy='Write the name of a column, or { column = "name", scale = 1.0, offset = 0.0 }',
        )
    return spec


Columns = Annotated[Mapping[Channel, Annotated[Column, BeforeValidator(_named)]], BeforeValidator(_in_si)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording(Keys):
    """A recording of the campaign: `[[recording]]`."""

    file: Annotated[str, Field(min_length=1)]  # as written; `Campaign.path_of` finds it
    kind: Kind
    use: Use
    skip_s: Annotated[Number, key("duration to skip at the start", 0.0)] = 0.0
    instrument: str = ""  # the measuring instrument: recordings of one instrument have the same noise
    board: str = ""  # name of the board, in a log of several boards
    columns: Columns = field(default_factory=dict)  # explicitly mapped channels

    def column(self, channel: Channel) -> Column:
        """Return the mapping of a channel; by default a column of the same name in SI units."""
        return self.columns.get(channel) or Column(column=channel)


def _fit_or_judge(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    uses: dict[str, Use] = {}
    for recording in recordings:
        if uses.setdefault(recording.file, recording.use) != recording.use:
            raise RuleError(
                f": {recording.file!r} is used both to fit and to judge",
                remedy="Keep one of the two: data used to fit cannot judge the fit",
            )
    return recordings


@dataclass(frozen=True, kw_only=True)
class PlantFile:
    """The required content of a file that describes a rig."""

    # The last one is the first to run.
    plant: Annotated[Plant, BeforeValidator(refuse_impossible), BeforeValidator(with_defaults)]


@dataclass(frozen=True, kw_only=True)
class _File(PlantFile, Keys):
    """The content of `campaign.toml`."""

    controller: Controller | None = None
    recording: Annotated[tuple[Recording, ...], Field(min_length=1), AfterValidator(_fit_or_judge)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign file, read and checked.

    [plant]
    name = "ce152"
    mass_kg = 8.28e-3
    travel_m = 5.7e-3
    x_max_m = 5.7e-3           # optional, default travel_m
    gravity_m_s2 = 9.81        # optional
    ball_diameter_m = 12.6e-3  # optional, of a ball of steel: the mass is compared with it
    assumed = false            # optional; true: nobody stated the plant
    [controller]               # optional
    kind = "lqi"               # lqi | pid
    gains = [0.49, 1700.0, 17.7, -17600.0]
    operating_point = { i_c_a = 0.6, x_m = 2.85e-3, u_c_v = 2.1 }
    [[recording]]
    file = "run7.csv.gz"       # CSV (also .gz), MATLAB or MCAP
    kind = "closed-loop"       # amplifier-step | sawtooth | prbs | closed-loop | equilibria | free
    use = "judge"              # fit | judge
    skip_s = 3.0               # optional
    instrument = "scope"       # optional: recordings of one instrument have the same noise
    board = "rig"              # optional, for a log of several boards
    columns = { t = "t_s", u_c = { column = "duty", table = [[0.0, 0.04], [0.1, 0.61]] } }
    """

    where: str  # the file, for messages
    folder: Path
    plant: Plant
    controller: Controller | None
    recordings: tuple[Recording, ...]

    @classmethod
    def load(cls, path: Path | str) -> Campaign:
        """Read a campaign file under any name, or the `campaign.toml` of a folder.

        Raises:
            DataError: the file is absent or not text.
            ConfigError: a key or a value is wrong.
        """
        text, file = _read(Path(path), remedy="Name a campaign.toml or its folder")
        return parse(text, where=str(file), folder=file.parent)

    def path_of(self, recording: Recording, *, data: Path | None = None) -> Path:
        """Return the path of a recording: in the campaign's folder, else in the data folder (default `$BOARD51_DATA`).

        A campaign may come from an untrusted source.  Its recordings must therefore lie, after resolving links, in the
        campaign's folder or in the data folder that the user has named; no other file of the user can be read.

        Raises:
            DataError: the file is in neither folder.
        """
        shared = data or (Path(os.environ["BOARD51_DATA"]) if os.environ.get("BOARD51_DATA") else None)
        folders = [folder for folder in (self.folder, shared) if folder is not None]
        candidates = [folder / recording.file for folder in folders]
        places = [_whereabouts(candidate, folders) for candidate in candidates]
        if "within" in places:
            return candidates[places.index("within")]
        where = " nor at ".join(str(candidate) for candidate in candidates)
        problem = "lies outside the campaign's folder" if "outside" in places else f"is not at {where}"
        raise DataError(
            f"{self.where}: recording {recording.file!r} {problem}",
            remedy="Put it beside the campaign, or name its folder with --data or BOARD51_DATA",
        )


def _whereabouts(file: Path, folders: Sequence[Path]) -> Literal["within", "outside", "absent"]:
    """Return whether a file lies in one of the folders, after resolving links."""
    try:
        real = file.resolve()
        if not any(real.is_relative_to(folder.resolve()) for folder in folders):
            return "outside"
        return "within" if real.exists() else "absent"
    except (OSError, RuntimeError, ValueError):  # no permission, a loop of links, or an invalid file name
        return "absent"


load = Campaign.load


def load_plant(path: Path) -> Plant:
    """Read only the `[plant]` table of a campaign, or of a file that contains nothing else.

    Raises:
        DataError: the file is absent or not text.
        ConfigError: there is no `[plant]`, or one of its keys or values is wrong.
    """
    text, file = _read(path, remedy="Name a file with a [plant] table, or a campaign's folder")
    plant: Plant = checked(PlantFile, parse_toml(text, where=str(file)), where=str(file)).plant
    return plant


def load_stated_plant(path: Path) -> Plant:
    """Read the `[plant]` of a file, as `load_plant`, for the plant card of a rig.

    Raises:
        DataError: the file is absent or not text.
        ConfigError: there is no `[plant]`, it is wrong, or it is assumed: then nobody has stated it.
    """
    plant = load_plant(path)
    if plant.assumed:
        raise ConfigError(
            f"{path}: plant.assumed = true: nobody stated this plant",
            remedy="Write mass and travel of the rig, and delete `assumed`",
        )
    return plant


def parse(text: str, *, where: str, folder: Path = Path()) -> Campaign:
    """Parse a campaign in TOML; `where` names it in errors, `folder` is that of its recordings.

    Raises:
        ConfigError: a key or a value is wrong.
    """
    file: _File = checked(_File, parse_toml(text, where=where), where=where)
    return Campaign(where=where, folder=folder, plant=file.plant, controller=file.controller, recordings=file.recording)


def _read(path: Path, *, remedy: str) -> tuple[str, Path]:
    file = path / "campaign.toml" if path.is_dir() else path
    return read_small(file, remedy=remedy), file
