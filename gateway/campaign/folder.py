"""The folder of a campaign: an MCAP file per experiment, `campaign.toml` for the tools, `run.json` to continue a run.

Rule 1: each file is complete or absent: recordings and both lists are written to a temporary file, synced and renamed.
Rule 2: a recording is listed after it was written.  Files that are not in `campaign.toml` are not part of the campaign.
Rule 3: a folder is for one rig and one plan.  Another board, plant, law or plan is refused with the difference.
Rule 4: `[plant]` of `campaign.toml` may be corrected by hand.  A plant that was assumed may be stated later.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from gateway.board.emulated import CE152
from gateway.campaign.plan import CommandLimits
from gateway.campaign.subscriber import Recorded
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.campaign import Campaign, Controller, OperatingPoint, Plant, PlantFile, Recording, load_plant
from protocol.campaign_text import emit
from protocol.checked import Flag, Number, Whole, checked, key
from protocol.errors import DataError, ServiceError, UsageError
from protocol.experiments import EXPERIMENT_OF_NAME, MENU, Experiment
from protocol.files import make_folder, parse_json, read_small, replace_text

RUN_FILE = "run.json"
_READABLE = "Give a new folder; the recordings here stay readable"
FORMAT = 1
ASSUMED = replace(CE152, assumed=True)  # for a rig whose plant nobody stated


@dataclass(slots=True, kw_only=True)
class Retained:
    """A recording of the folder."""

    bytes: Whole
    seconds: Number
    attempts: Whole
    plan: dict[str, Any]  # of `plan_of`
    said: list[str] = field(default_factory=list)  # problems of earlier attempts


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    format: Annotated[Whole, key("format of the file", FORMAT, FORMAT)]
    identity: dict[str, dict[str, Any]]
    lift_off_v: Number | None
    recordings: dict[str, Retained]
    left: list[str] = field(default_factory=list)
    quick: Flag = False


def identity_of(board: str, parameters: pb.Parameters, plant: Plant) -> dict[str, Any]:
    """The data that must be the same for all recordings of a folder."""
    return {
        "board": {"name": board, "board_id": parameters.board_id, "sample_time_s": parameters.sample_time_s},
        "plant": asdict(plant),
        "law": {
            "law": pb.Law.Name(parameters.law),
            "gains": list(parameters.gains),
            "operating_point": [parameters.i_0_a, parameters.x_0_m, parameters.u_0_v],
        },
    }


def plan_of(experiment: Experiment, limits: CommandLimits, seed: int) -> dict[str, Any]:
    """The data that must be the same for two recordings to be the same experiment."""
    steps = [{"step": type(step).__name__, **asdict(step)} for step in experiment.steps]
    return {"steps": steps, "seed": seed, "limits": asdict(limits)}


def controller_of(parameters: pb.Parameters) -> Controller:
    """The `[controller]` section from the board's parameters."""
    k1, k2, k3, k4 = parameters.gains
    return Controller(
        kind="lqi" if parameters.law == pb.LAW_LQI else "pid",
        gains=(k1, k2, k3, k4),
        operating_point=OperatingPoint(i_c_a=parameters.i_0_a, x_m=parameters.x_0_m, u_c_v=parameters.u_0_v),
    )


class Folder:
    """A campaign's folder, new or to be continued; `claim` creates it.

    Raises:
        UsageError: it has a campaign that `campaign run` did not make.
        DataError: its run.json is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lift_off_v: float | None = None
        self.retained: dict[str, Retained] = {}
        self.left: list[str] = []  # experiments of interrupted runs that are still to do
        self.quick = False  # of the latest run
        self._identity: dict[str, Any] | None = None
        if (path / RUN_FILE).exists():
            self._load()
        elif (path / "campaign.toml").exists():
            raise UsageError(
                f"{path} holds a campaign that `campaign run` did not make", remedy="Give a new folder for this one"
            )

    def _load(self) -> None:
        file = self.path / RUN_FILE
        table = parse_json(read_small(file, remedy=_READABLE), where=str(file), remedy=_READABLE)
        known: _File = checked(_File, table, where=str(file), error=DataError, remedy=_READABLE)
        self.lift_off_v, self._identity = known.lift_off_v, known.identity
        self.retained = {name: retained for name, retained in known.recordings.items() if name in EXPERIMENT_OF_NAME}
        self.left, self.quick = known.left, known.quick
        if (self.path / "campaign.toml").exists():
            # By the TOML, which a person may have corrected since (rule 4).
            self._identity["plant"] = asdict(load_plant(self.path))

    @property
    def plant(self) -> Plant | None:
        """The plant of a folder that was begun; None for a new one.  Raises DataError if it is damaged."""
        if self._identity is None:
            return None
        stated, where = {"plant": self._identity.get("plant")}, str(self.path / RUN_FILE)
        file: PlantFile = checked(PlantFile, stated, where=where, error=DataError, remedy=_READABLE)
        return file.plant

    def claim(self, identity: Mapping[str, Any]) -> None:
        """Create the folder for this rig (`identity_of`), or check that it is of this rig.

        Raises:
            UsageError: the folder is of another rig, or cannot be created.
        """
        # A folder without a recording is bound to no rig yet.
        if self._identity is not None and self.retained:
            for part, known in self._identity.items():
                if known.get("assumed"):
                    continue
                now = identity.get(part, {})
                differing = [key for key in known if known[key] != now.get(key)]
                if differing:
                    key = differing[0]
                    raise UsageError(
                        f"{self.path} is of another {part}: {key} was {known[key]}, is {now.get(key)}",
                        remedy="Give a new folder, or the same board, plant and gains as before",
                    )
        self._identity = dict(identity)
        make_folder(self.path)

    def begin(self, names: Sequence[str], *, quick: bool) -> None:
        """Note the experiments of a run: they are left to do until they are recorded, or until `settle`."""
        self.left, self.quick = [*self.left, *(name for name in names if name not in self.left)], quick

    def settle(self, names: Sequence[str]) -> None:
        """Note that nothing is left to do for these experiments."""
        self.left = [name for name in self.left if name not in names]

    def has(self, name: str, plan: Mapping[str, Any]) -> bool:
        """Return whether the folder has the complete recording.

        Raises:
            UsageError: it has one that was made by another plan.
        """
        retained = self.retained.get(name)
        file = self.file_of(name)
        if retained is None or not file.is_file() or file.stat().st_size != retained.bytes:
            return False
        known = json.loads(json.dumps(plan))  # as run.json would give it back
        if retained.plan != known:
            raise UsageError(
                f"{file} was made by another plan: {_difference(retained.plan, known)}",
                remedy="Repeat the options of that run, give a new folder, or delete that file to record it again",
            )
        return True

    def file_of(self, name: str) -> Path:
        """Path of a recording."""
        return self.path / f"{name}.mcap"

    def keep(
        self, experiment: Experiment, recorded: Recorded, retained: Retained, controller: Controller | None
    ) -> None:
        """Write a recording and list it.

        Raises:
            ServiceError: the file cannot be written.
        """
        file, part = self.file_of(experiment.name), self.path / f".{experiment.name}.part"
        part.unlink(missing_ok=True)
        description = {"experiment": experiment.name, "kind": experiment.kind, "use": experiment.use}
        with LogWriter(part, metadata={"campaign": description}, compression="zstd") as writer:
            for message in recorded.messages:
                writer.write(*message)
        # The size is kept, so that a file that was cut or exchanged is recorded again.
        retained.bytes = part.stat().st_size
        part.replace(file)
        self.retained[experiment.name] = retained
        self.settle([experiment.name])
        self.save(controller)

    def drop(self, name: str) -> None:
        """Remove a recording from the list, to be made again."""
        self.retained.pop(name, None)

    def save(self, controller: Controller | None) -> None:
        """Write both lists.  Raises ServiceError if that is not possible."""
        assert self._identity is not None
        table = {
            "format": FORMAT,
            "identity": self._identity,
            "lift_off_v": self.lift_off_v,
            "recordings": {name: asdict(retained) for name, retained in self.retained.items()},
            "left": self.left,
            "quick": self.quick,
        }
        self._write(RUN_FILE, json.dumps(table, indent=1) + "\n")
        if self.retained:
            self._write("campaign.toml", self._campaign(Plant(**self._identity["plant"]), controller))
        else:
            (self.path / "campaign.toml").unlink(missing_ok=True)

    def _campaign(self, plant: Plant, controller: Controller | None) -> str:
        recordings = tuple(
            Recording(file=f"{e.name}.mcap", kind=e.kind, use=e.use) for e in MENU if e.name in self.retained
        )
        comments = ["Made by `board51 campaign run`.  run.json beside it says how."]
        if plant.assumed:
            comments += [
                "[plant]: nobody stated it; the published constants of a CE 152 are assumed.  K_c and b hold for that",
                "plant only.  Write the mass and the travel of this rig, delete `assumed`, and identify again.",
                "State them on the model page of the rig, too: then the next campaign has them.",
            ]
        if replace(plant, assumed=False) == CE152:
            comments += [
                "[plant]: the published constants of a CE 152; this rig was not measured.  x_max = travel puts the",
                "coil's plane at the top stop; correct x_max_m if you know better.",
            ]
        whole = Campaign(where="", folder=self.path, plant=plant, controller=controller, recordings=recordings)
        return emit(whole, comments=comments)

    def _write(self, name: str, text: str) -> None:
        try:
            replace_text(self.path / name, text)
        except OSError as error:
            raise ServiceError(
                f"{self.path / name} cannot be written: {error.strerror}",
                remedy="Make room or give write permission; the same command continues",
            ) from None


def _difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    if old.get("seed") != new["seed"]:
        return f"--seed was {old.get('seed')}, is {new['seed']}"
    for limit, value in new["limits"].items():
        if old.get("limits", {}).get(limit) != value:
            return f"the limit {limit} was {old.get('limits', {}).get(limit, float('nan')):.4g}, is {value:.4g}"
    return "its steps differ (with and without --quick, or another version of the menu)"
