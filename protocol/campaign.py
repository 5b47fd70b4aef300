"""A campaign: what is known of a plant, what ran on the board, and the recordings made of it.

`campaign.toml` as drawn in `Campaign`; `parse` takes its text, `load` a file or the folder around it.  The recordings
themselves are not opened here.

Rule 1: an error names file, key and value, and says what to write instead; an unknown key is an error.
Rule 2: units are in the keys; a value that can only be another unit (a travel of 5.7 m) is refused.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

from protocol.errors import ConfigError, DataError
from protocol.files import parse_toml, read_small
from protocol.toml_table import TomlTable, is_number, shown
from protocol.units import unit_of_name

Channel = Literal["t", "u_c", "i_c", "x", "x_ref"]
Kind = Literal["amplifier-step", "sawtooth", "prbs", "closed-loop", "equilibria", "free"]
Use = Literal["fit", "judge"]

CHANNELS: tuple[Channel, ...] = ("t", "u_c", "i_c", "x", "x_ref")
UNITS: Mapping[str, str] = {"t": "s", "u_c": "V", "i_c": "A", "x": "m", "x_ref": "m"}
KINDS: tuple[Kind, ...] = ("amplifier-step", "sawtooth", "prbs", "closed-loop", "equilibria", "free")
USES: tuple[Use, ...] = ("fit", "judge")
CONTROLLERS = ("lqi", "pid")
GRAVITY_M_S2 = 9.81
# What a ball on a coil can have: (lowest, highest, what that is).  The bounds catch a wrong unit and a slipped power of
# ten: with grams for kilograms K_c comes out a thousand times too large, and nothing in the recordings contradicts it.
PLANT_BOUNDS: Mapping[str, tuple[float, float, str]] = {
    "mass_kg": (1e-4, 2.0, "as steel balls of 2.9 to 79 mm have"),
    "travel_m": (1e-4, 0.5, ""),
    "x_max_m": (1e-4, 0.5, ""),
    "gravity_m_s2": (1.0, 20.0, ""),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """What is known without identification: `[plant]`."""

    name: str
    mass_kg: float
    travel_m: float  # highest position of the ball (top stop); 0 is the sensor
    x_max_m: float  # x_max of eq. (3)
    gravity_m_s2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """Eq. (13)."""

    i_c_a: float
    x_m: float
    u_c_v: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """The law of the closed-loop recordings: `[controller]`, eq. (16)-(19)."""

    kind: str  # one of CONTROLLERS
    gains: tuple[float, float, float, float]
    operating_point: OperatingPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """Where a channel comes from: value = offset + scale * table(raw), in SI units.

    The table is linear between its points and beyond its ends.
    """

    column: str
    scale: float = 1.0
    offset: float = 0.0
    table: tuple[tuple[float, float], ...] = ()

    def convert(self, raw: float) -> float:
        """One value."""
        return self.offset + self.scale * (self._look_up(raw) if self.table else raw)

    def beyond_table(self, raw: float) -> bool:
        """Whether `convert` has to extrapolate."""
        return bool(self.table) and not self.table[0][0] <= raw <= self.table[-1][0]

    def _look_up(self, raw: float) -> float:
        right = bisect_right(self.table, raw, key=lambda point: point[0])
        right = min(max(right, 1), len(self.table) - 1)
        (x0, y0), (x1, y1) = self.table[right - 1], self.table[right]
        return y0 + (y1 - y0) * ((raw - x0) / (x1 - x0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """One `[[recording]]`."""

    file: str  # as written; `Campaign.path_of` finds it
    kind: Kind
    use: Use
    skip_s: float = 0.0  # leave out the start
    board: str = ""  # in a log of several boards, the one that is meant
    columns: Mapping[Channel, Column] = field(default_factory=dict)  # the channels that were mapped

    def column(self, channel: Channel) -> Column:
        """The mapping of a channel; one that was not mapped has its own name and SI units."""
        return self.columns.get(channel) or Column(column=channel)


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """The whole file.

    [plant]
    name = "ce152"
    mass_kg = 8.28e-3
    travel_m = 5.7e-3
    x_max_m = 5.7e-3           # optional, default travel_m
    gravity_m_s2 = 9.81        # optional
    [controller]               # optional
    kind = "lqi"               # lqi | pid
    gains = [0.49, 1700.0, 17.7, -17600.0]
    operating_point = { i_c_a = 0.6, x_m = 2.85e-3, u_c_v = 2.1 }
    [[recording]]
    file = "run7.csv.gz"       # CSV (also .gz), MATLAB or MCAP
    kind = "closed-loop"       # amplifier-step | sawtooth | prbs | closed-loop | equilibria | free
    use = "judge"              # fit | judge
    skip_s = 3.0               # optional
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
        """Read campaign.toml, or that of a folder.

        Raises:
            DataError: see the text; it names file, key and value.
        """
        return load(Path(path))

    def path_of(self, recording: Recording, *, data: Path | None = None) -> Path:
        """The recording's file: in the campaign's folder, else in the data folder.

        A campaign may come from somebody else.  What it names must therefore lie, links followed, in its own folder or
        in the one that the user has named; it cannot point `identify` at any other file of the user's.

        Args:
            recording: One of this campaign.
            data: Folder with recordings that are not kept beside the campaign; default `$BOARD51_DATA`.

        Raises:
            DataError: it is in neither.
        """
        shared = data or (Path(os.environ["BOARD51_DATA"]) if os.environ.get("BOARD51_DATA") else None)
        folders = [folder for folder in (self.folder, shared) if folder is not None]
        candidates = [folder / recording.file for folder in folders]
        places = [_place(candidate, folders) for candidate in candidates]
        if "within" in places:
            return candidates[places.index("within")]
        where = " nor at ".join(str(candidate) for candidate in candidates)
        problem = "lies outside the campaign's folder" if "outside" in places else f"is not at {where}"
        raise DataError(
            f"{self.where}: recording {recording.file!r} {problem}",
            remedy="Put it beside the campaign, or name its folder with --data or BOARD51_DATA",
        )


def _place(file: Path, folders: Sequence[Path]) -> Literal["within", "outside", "absent"]:
    """Whether a file lies in one of the folders, links followed."""
    try:
        real = file.resolve()
        if not any(real.is_relative_to(folder.resolve()) for folder in folders):
            return "outside"
        return "within" if real.exists() else "absent"
    except (OSError, RuntimeError, ValueError):  # not allowed, a loop of links, no name of a file
        return "absent"


def load(path: Path) -> Campaign:
    """Read a campaign.

    Args:
        path: `campaign.toml`, under any name, or the folder that holds one.

    Raises:
        DataError: it is absent or not text.
        ConfigError: a key or a value is wrong.
    """
    text, file = _read(path, remedy="Name a campaign.toml or its folder")
    return parse(text, where=str(file), folder=file.parent)


def load_plant(path: Path) -> Plant:
    """Only the `[plant]` of a campaign or of a file that has nothing else.

    Raises:
        DataError: it is absent or not text.
        ConfigError: it has no `[plant]`, or a key or a value of it is wrong.
    """
    text, file = _read(path, remedy="Name a file with a [plant] table, or a campaign's folder")
    return _plant(_top(text, where=str(file)).table("plant"))


def parse(text: str, *, where: str, folder: Path = Path()) -> Campaign:
    """The campaign in `text`.

    Args:
        text: TOML.
        where: Name of the file, for messages.
        folder: What the recordings' names are relative to.

    Raises:
        ConfigError: a key or a value is wrong.
    """
    top = _top(text, where=where)
    plant = _plant(top.table("plant"))
    controller = _controller(top.table("controller")) if "controller" in top.values else None
    recordings = tuple(_recording(table) for table in top.tables("recording"))
    top.done()
    uses: dict[str, Use] = {}
    for recording in recordings:
        if uses.setdefault(recording.file, recording.use) != recording.use:
            raise ConfigError(
                f"{where}: {recording.file!r} is used both to fit and to judge",
                remedy="Keep one of the two: what was fitted cannot judge the fit",
            )
    return Campaign(where=where, folder=folder, plant=plant, controller=controller, recordings=recordings)


def _read(path: Path, *, remedy: str) -> tuple[str, Path]:
    file = path / "campaign.toml" if path.is_dir() else path
    return read_small(file, remedy=remedy), file


def _top(text: str, *, where: str) -> TomlTable:
    return TomlTable(where, "", parse_toml(text, where=where))


def parse_column(spec: object, *, where: str, key: str, channel: Channel) -> Column:
    """A column from its TOML form: a name, or `{ column = ..., scale = ..., offset = ..., table = ... }`.

    Raises:
        ConfigError: it is neither, or its name ends with another unit than the channel's and it has no scale.
    """
    column = _column(spec, where=where, key=key)
    unit = unit_of_name(column.column, channel)
    scaled = isinstance(spec, dict) and ("scale" in spec or "table" in spec)
    if unit is not None and not scaled:
        raise ConfigError(
            f"{where}: {key} = {shown(column.column)} is in {unit[0]} by its name, {channel} is in {UNITS[channel]}",
            remedy=f"Give it scale = {unit[1]:g}, or scale = 1.0 if its values are in {UNITS[channel]} all the same",
        )
    return column


def _column(spec: object, *, where: str, key: str) -> Column:
    if isinstance(spec, str):
        return Column(column=spec)
    if not isinstance(spec, dict):
        raise ConfigError(
            f"{where}: {key} = {shown(spec)} is not a column",
            remedy='Write the name of a column, or { column = "name", scale = 1.0, offset = 0.0 }',
        )
    table = TomlTable(where, key, cast("dict[str, object]", spec))
    column = Column(
        column=table.text("column"),
        scale=table.number("scale", default=1.0),
        offset=table.number("offset", default=0.0),
        table=_points(table) if "table" in table.values else (),
    )
    table.done()
    if column.scale == 0.0:
        raise ConfigError(f"{where}: {key}.scale = 0 makes every value equal", remedy="Give the SI value of one unit")
    return column


def _plant(table: TomlTable) -> Plant:
    name = table.text("name", default="plant")
    defaults = {"gravity_m_s2": GRAVITY_M_S2}
    values: dict[str, float] = {}
    for key, (low, high, meaning) in PLANT_BOUNDS.items():
        values[key] = table.number(key, low=low, high=high, default=defaults.get(key), meaning=meaning)
        defaults["x_max_m"] = values.get("travel_m", 0.0)
    plant = Plant(name=name, **values)
    table.done()
    return plant


def _controller(table: TomlTable) -> Controller:
    kind = table.choice("kind", CONTROLLERS)
    gains = table.numbers("gains", 4)
    point = table.table("operating_point")
    operating_point = OperatingPoint(i_c_a=point.number("i_c_a"), x_m=point.number("x_m"), u_c_v=point.number("u_c_v"))
    point.done()
    table.done()
    return Controller(kind=kind, gains=(gains[0], gains[1], gains[2], gains[3]), operating_point=operating_point)


def _recording(table: TomlTable) -> Recording:
    file = table.text("file")
    table.key += f" ({file})"
    columns: dict[Channel, Column] = {}
    if "columns" in table.values:
        mapped = table.table("columns")
        for channel in CHANNELS:
            if channel in mapped.values:
                columns[channel] = parse_column(
                    mapped.take(channel), where=mapped.where, key=f"{mapped.key}.{channel}", channel=channel
                )
        mapped.done(CHANNELS)
    recording = Recording(
        file=file,
        kind=cast(Kind, table.choice("kind", KINDS)),
        use=cast(Use, table.choice("use", USES)),
        skip_s=table.number("skip_s", low=0.0, default=0.0),
        board=table.text("board", default=""),
        columns=columns,
    )
    table.done()
    return recording


def _points(table: TomlTable) -> tuple[tuple[float, float], ...]:
    raw = table.take("table")
    key = f"{table.key}.table"
    remedy = "Write two or more [raw, value] pairs with rising raw values"
    if not isinstance(raw, list) or len(raw) < 2:
        raise ConfigError(f"{table.where}: {key} = {shown(raw)} is not a look-up table", remedy=remedy)
    points: list[tuple[float, float]] = []
    for number, pair in enumerate(raw, 1):
        if not isinstance(pair, list) or len(pair) != 2 or not all(is_number(value) for value in pair):
            raise ConfigError(f"{table.where}: {key}, point {number} = {shown(pair)} is not a pair", remedy=remedy)
        points.append((float(pair[0]), float(pair[1])))
        if number > 1 and points[-1][0] <= points[-2][0]:
            raise ConfigError(f"{table.where}: {key}, point {number} = {pair!r} does not rise", remedy=remedy)
    return tuple(points)
