"""The reader of each file from outside, and how such a file goes wrong: the table of `test_hostile_input.py`."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from gateway.access.roles import Role
from gateway.access.users import User, Users, set_user
from gateway.campaign.folder import Folder
from gateway.config import documented_toml, load_config
from gateway.emulator.own_rig import load_rig
from gateway.emulator.plant.secret import FORMAT, open_sealed
from gateway.investigate.journal import open_journal
from gateway.record.byte_replay import RecordedBoard
from gateway.record.recover import recover
from gateway.record.summary import as_text, summarise
from gateway.record.tables.export import Format, export
from gateway.record.tables.table_import import import_recording
from gateway.record.timeline import timeline
from gateway.views.hmi.gains import parse_gains
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse
from protocol.campaign import Recording, load, load_stated_plant
from protocol.diagnosis import load_diagnosis
from protocol.log.reader import LogReader, read
from tests.harness import mutations
from tests.harness.gateway.heavy_rig import HEAVY_RIG
from tests.harness.hostile_messages import message, usual_messages, write_log
from tests.harness.twin.true_model import true_model
from twin.control_design.controller_file import read_controller
from twin.model.parameters import Model
from twin.readers.campaign import read_flight

CAMPAIGN = """
[plant]
name = "ce152"
mass_kg = 8.28e-3
travel_m = 5.7e-3
x_max_m = 8.138e-3
ball_diameter_m = 12.6e-3
[controller]
kind = "lqi"
gains = [0.49, 1700.0, 17.7, -17600.0]
operating_point = {i_c_a = 0.63, x_m = 2.85e-3, u_c_v = 2.14}
[[recording]]
file = "table.csv"
kind = "closed-loop"
use = "fit"
skip_s = 0.5
[recording.columns]
x = {column = "x", scale = 1e-3, offset = 0.0, table = [[0.0, 1.0], [1.0, 2.0]]}
u_c = "u"
"""
TABLE = "t,u_c,i_c,x\n" + "".join(f"{n * 2e-3:.3f},1.0,0.{n},0.00{n % 5}\n" for n in range(20))
CONTROLLER = {
    "law": "lqi", "gains": [0.49, 1700.0, 17.7, -17600.0], "sample_time_s": 2e-3,
    "operating_point": {"i_0_a": 0.6, "x_0_m": 2.8e-3, "u_0_v": 2.1},
}  # fmt: skip
SEPARATION = {"force-exponent": 1.5, "position-sensor-gain": None}
CAUSE = {
    "name": "air-gap-offset", "confidence": 0.9, "indistinguishable_from": ["force-exponent"],
    "parameters": {"delta": {"value": 1e-4, "unit": "m", "ci95": [0.0, 2e-4]}},
    "next_experiment": {
        "separation_z_now": SEPARATION, "experiments": [{"name": "holds", "separation_z": SEPARATION}],
        "not_separable_here": ["Measure the gap."],
    },
}  # fmt: skip
DIAGNOSIS = {"verdict": "causes-found", "sentence": "It is so.", "causes": [CAUSE], "candidates": []}
JOURNAL = {
    "format": 1, "board": "rig",
    "steps": [
        {"performed": {"why": "first", "standings": {"holds": "kept"}, "rig_s": 20.0}},
        {"diagnosed": {"why": "then", "thorough": True, "recordings": ["holds"], "found": DIAGNOSIS}},
    ],
}  # fmt: skip
RUN = {
    "format": 1, "lift_off_v": 1.9, "left": ["holds"], "quick": False,
    "identity": {"board": {"name": "rig"}, "plant": tomllib.loads(CAMPAIGN)["plant"] | {"gravity_m_s2": 9.81}},
    "recordings": {"holds": {"bytes": 10, "seconds": 1.0, "attempts": 1, "plan": {"seed": 1}, "said": ["x"]}},
}  # fmt: skip


Make = Callable[[Random, Path], bytes]  # chance, a file that may be written on the way; the content


@dataclass(frozen=True, slots=True)
class Reader:
    """The reader of a file of this name; `make` gives the content of one that is wrong."""

    file: str
    make: Make
    read: Callable[[Path], object]
    names: tuple[str, ...] = ()  # what an error speaks of, where the reader is not told the file's name


def _toml(text: str) -> Make:
    """Half of the mutants are of the tree, half of the text."""
    valid = tomllib.loads(text)

    def make(chance: Random, _: Path) -> bytes:
        if chance.randrange(2):
            return mutations.as_toml(mutations.tree(chance, valid))
        return mutations.text(chance, text.encode())

    return make


def _json(valid: Any) -> Make:
    text = json.dumps(valid, indent=1).encode()

    def make(chance: Random, _: Path) -> bytes:
        if chance.randrange(4):
            return mutations.as_json(mutations.tree(chance, valid))
        return mutations.text(chance, text)

    return make


def _gains(chance: Random, _: Path) -> bytes:
    return mutations.as_toml(mutations.tree(chance, CONTROLLER))


def _table(chance: Random, _: Path) -> bytes:
    return mutations.text(chance, TABLE.encode())


@cache
def _matrices() -> bytes:
    from scipy.io import savemat

    out: Any = io.BytesIO()
    t = np.arange(20) * 2e-3
    savemat(out, {"t": t, "x": t, "u_c": t, "i_c": t, "run": {"x": t}, "note": "text"})
    return bytes(out.getvalue())


def _mat(chance: Random, _: Path) -> bytes:
    return mutations.binary(chance, _matrices())


def _damaged_log(chance: Random, scratch: Path) -> bytes:
    return mutations.binary(chance, write_log(scratch, usual_messages()))


def _log(chance: Random, scratch: Path) -> bytes:
    """A whole log with messages that nobody would write."""
    messages = usual_messages()
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(messages))
        messages[at] = (messages[at][0], message(chance, messages[at][1]))
    return write_log(scratch, messages)


def envelope_of(content: bytes) -> bytes:
    """Return a file that was sealed in order."""
    packed, commitment = base64.b64encode(zlib.compress(content)).decode(), hashlib.sha256(content).hexdigest()
    return json.dumps({"format": FORMAT, "content": packed, "commitment": commitment}).encode()


def _sealed(chance: Random, _: Path) -> bytes:
    return envelope_of(mutations.as_json(mutations.tree(chance, {"effects": {"quadratic-drag": 1.0}, "salt": "a"})))


def _users(chance: Random, scratch: Path) -> bytes:
    scratch.unlink(missing_ok=True)
    set_user(scratch, User(name="ana", role=Role.ENGINEER), "correct horse")
    return _toml(scratch.read_text())(chance, scratch)


def _read_log(path: Path) -> None:
    """Read a log as `info`, the page and a replay do."""
    as_text(summarise(path))
    timeline(path)
    for _ in read(path):
        pass


def _replay_bytes(path: Path) -> None:
    pieces = (parse(pb.RawBytes, record.data) for record in LogReader(path).raw(topics_=["raw"]))
    RecordedBoard(piece for piece in pieces if piece is not None)


def _read_users(path: Path) -> None:
    path.chmod(0o600)
    Users(path).check("ana", "another")


def _parse_gains(path: Path) -> None:
    parse_gains(path.read_bytes(), pb.Parameters(sample_time_s=2e-3, u_max_v=5.0, x_ref_max_m=5e-3))


def _import(path: Path) -> None:
    log = path.with_suffix(".mcap")
    log.unlink(missing_ok=True)
    import_recording(path, log, Recording(file=path.name, kind="free", use="fit"), board="rig")


def _export(form: Format, path: Path) -> None:
    out = path.with_suffix(f".{form}")
    out.unlink(missing_ok=True)
    export(path, out, form=form)


def _recover(path: Path) -> None:
    clean = path.with_name("clean.mcap")
    clean.unlink(missing_ok=True)
    recover(path, clean)


GAINS = ("The file", "law ", "gains ", "The gains", "operating_point ", "x_0 = ")
READERS = {
    "campaign": Reader("campaign.toml", _toml(CAMPAIGN), load),
    "plant": Reader("plant.toml", _toml(CAMPAIGN), load_stated_plant),
    "own rig": Reader("rig.toml", _toml(HEAVY_RIG), load_rig, ("Rig: ",)),
    "configuration": Reader("gateway.toml", _toml(documented_toml()), partial(load_config, environment={})),
    "model": Reader("model.json", _json(true_model(effects={"quadratic-drag": 1.0}).to_json()), Model.load),
    "controller": Reader("controller.json", _json(CONTROLLER), read_controller),
    "gains": Reader("gains.json", _json(CONTROLLER), _parse_gains, GAINS),
    "gains in TOML": Reader("gains.toml", _gains, _parse_gains, GAINS),
    "diagnosis": Reader("diagnosis.json", _json(DIAGNOSIS), load_diagnosis),
    "journal": Reader("investigation.json", _json(JOURNAL), lambda path: open_journal(path.parent, "rig")),
    "run": Reader("run.json", _json(RUN), lambda path: Folder(path.parent).plant),
    "sealed": Reader("sealed.json", _sealed, open_sealed, ("Effect ", "effect ")),
    "users": Reader("users.toml", _users, _read_users),
    "table, twin": Reader("table.csv", _table, read_flight),
    "table, import": Reader("table.csv", _table, _import),
    "matrix, twin": Reader("table.mat", _mat, read_flight),
    "matrix, import": Reader("table.mat", _mat, _import),
    "damaged log": Reader("log.mcap", _damaged_log, _read_log),
    "damaged log, twin": Reader("log.mcap", _damaged_log, read_flight),
    "damaged log, recover": Reader("log.mcap", _damaged_log, _recover),
    "log": Reader("log.mcap", _log, _read_log),
    "log, twin": Reader("log.mcap", _log, read_flight),
    "log, csv": Reader("log.mcap", _log, partial(_export, "csv")),
    "log, mat": Reader("log.mcap", _log, partial(_export, "mat")),
    "log, byte replay": Reader("log.mcap", _log, _replay_bytes, ("The log ",)),
}
