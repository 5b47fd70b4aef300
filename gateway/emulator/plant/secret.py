"""Effects that nobody is told: drawn from a seed, kept in a sealed file to compare with afterwards.

The sealed file is JSON: `commitment` = SHA-256 over salt and content, and the content itself, packed so that nobody
reads it by accident.  It is an honest envelope, not encryption: whoever wants to look can.  The commitment may be shown
at once; opened later, the file proves that the effects were not changed in between.  The salt is inside the envelope,
so that the commitment alone cannot be guessed from the table of effects.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import secrets
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gateway.emulator.plant.effects import EFFECTS, Effect, check
from protocol.errors import Board51Error, DataError, UsageError
from protocol.files import LARGEST_SMALL, parse_json, read_small, writing

FORMAT = "board51-sealed-effects-1"
# Each of these alone leaves the nominal LQI its stability, two strong ones together do not: a ball on the floor would
# end every experiment, and a diagnosis needs one.
_DELAYING = frozenset({"actuation-delay", "eddy-current-lag", "position-sensor-lag", "sampling-delay"})
_PURPOSE = 0x5EA1  # keeps these draws apart from the sensor noise of a plant with the same seed


def draw(seed: int) -> dict[str, float]:
    """One to three effects with strengths between weak and strong, both signs where they are plausible.

    At most one of them delays the loop.  The same seed gives the same effects.

    Raises:
        UsageError: a negative seed.
    """
    if seed < 0:
        raise UsageError(f"Seed {seed} is negative", remedy="Give a whole number from 0")
    rng = np.random.default_rng([_PURPOSE, seed])
    count = int(rng.integers(1, 4))
    chosen: dict[str, float] = {}
    for name in rng.permutation(sorted(EFFECTS)).tolist():
        if len(chosen) == count:
            break
        if name in _DELAYING and _DELAYING & chosen.keys():
            continue
        chosen[name] = _strength(EFFECTS[name], rng)
    return chosen


def seal(path: Path, effects: Mapping[str, float]) -> str:
    """Write the sealed file and give its commitment, which may be shown.

    A file that already holds the same effects is left as it is, so that a restart with the same seed goes through.

    Raises:
        UsageError: the file exists and holds anything else.
        UsageError: it cannot be written.
    """
    if path.exists():
        try:
            same = open_sealed(path) == dict(effects)
        except Board51Error:
            same = False
        if not same:
            raise UsageError(
                f"{path} exists and is not the seal of this seed",
                remedy="Give another file, or delete this one if it is no longer needed",
            )
        return str(json.loads(path.read_text(encoding="utf-8"))["commitment"])
    content = json.dumps({"salt": secrets.token_hex(16), "effects": dict(effects)}, sort_keys=True).encode()
    commitment = hashlib.sha256(content).hexdigest()
    envelope = {
        "format": FORMAT,
        "commitment": commitment,
        "content": base64.b64encode(zlib.compress(content, 9)).decode("ascii"),
    }
    with writing(path):
        path.write_text(json.dumps(envelope, indent=1) + "\n", encoding="utf-8")
    return commitment


def open_sealed(path: Path) -> dict[str, float]:
    """The effects in a sealed file, after its commitment was checked.

    Raises:
        DataError: no such file, not a sealed file, or changed since it was sealed.
    """
    remedy = "Give the file that --sealed named"
    envelope = parse_json(read_small(path, remedy=remedy, what="Sealed file "), where=str(path), remedy=remedy)
    if not isinstance(envelope, dict) or envelope.get("format") != FORMAT:
        raise DataError(f"{path} is not a sealed file ({FORMAT})", remedy="Give the file that --sealed named")
    try:
        packed = base64.b64decode(str(envelope["content"]), validate=True)
        content = zlib.decompressobj().decompress(packed, LARGEST_SMALL)
        intact = hashlib.sha256(content).hexdigest() == envelope["commitment"]
    except (KeyError, binascii.Error, zlib.error):
        intact = False
    if not intact:
        raise DataError(
            f"Sealed file {path}: content and commitment differ",
            remedy="Get the file as it was written; it was changed",
        )
    effects = {str(name): float(value) for name, value in json.loads(content)["effects"].items()}
    check(effects)
    return effects


def _strength(effect: Effect, rng: np.random.Generator) -> float:
    """Log-uniform between weak and strong, seen from the neutral value, and mirrored there half the time if signed."""
    reference = effect.neutral if np.isfinite(effect.neutral) else 0.0
    weak, strong = effect.weak - reference, effect.strong - reference
    deviation = weak * (strong / weak) ** rng.random()
    if effect.signed and rng.random() < 0.5:
        deviation = -deviation
    return float(f"{reference + deviation:.3g}")
