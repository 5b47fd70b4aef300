"""Secret effects for blind tests: drawn from a seed, and stored in a sealed file for a later comparison.

The sealed file is JSON: `commitment` = SHA-256 over salt and content, and the content itself, packed so that it is not
read by accident.  It is not encrypted.  The commitment may be published at once; the file, opened later, then proves
that the effects were not changed.  The salt prevents guessing the effects from the commitment alone.
"""

from __future__ import annotations

import base64
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
# The nominal LQI is stable with each of these alone, but not with two strong ones: the ball would fall, which ends any
# experiment.
_DELAYING = frozenset({"actuation-delay", "eddy-current-lag", "position-sensor-lag", "sampling-delay"})
_PURPOSE = 0x5EA1  # keeps these draws apart from the sensor noise of a plant with the same seed


def draw(seed: int) -> dict[str, float]:
    """Draw one to three effects with strengths between weak and strong, of either sign where plausible.

    At most one of them delays the loop.  The same seed gives the same effects.

    Raises:
        UsageError: the seed is negative.
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
    """Write the sealed file, and return its commitment, which may be published.

    A file that already holds the same effects is not changed, so that a restart with the same seed is possible.

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
            problem = f"{path} exists and is not the seal of this seed"
            raise UsageError(problem, remedy="Give another file, or delete this one if it is no longer needed")
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
    """Check the commitment of a sealed file, and return the effects.

    Raises:
        DataError: the file is absent, not a sealed file, or was changed since it was sealed.
    """
    remedy = "Give the file that --sealed named"
    envelope = parse_json(read_small(path, remedy=remedy, what="Sealed file "), where=str(path), remedy=remedy)
    if not isinstance(envelope, dict) or envelope.get("format") != FORMAT:
        raise DataError(f"{path} is not a sealed file ({FORMAT})", remedy="Give the file that --sealed named")
    try:
        packed = base64.b64decode(str(envelope["content"]), validate=True)
        content = zlib.decompressobj().decompress(packed, LARGEST_SMALL)
        intact = hashlib.sha256(content).hexdigest() == envelope["commitment"]
    except (KeyError, ValueError, zlib.error):
        intact = False
    if not intact:
        problem = f"Sealed file {path}: content and commitment differ"
        raise DataError(problem, remedy="Use the original file; this one was changed")
    try:
        effects = {str(name): float(value) for name, value in json.loads(content)["effects"].items()}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise DataError(f"Sealed file {path} holds no effects with numbers", remedy=remedy) from None
    check(effects)
    return effects


def _strength(effect: Effect, rng: np.random.Generator) -> float:
    """Draw a strength, log-uniform in its distance from neutral between weak and strong; of either sign if signed."""
    reference = effect.neutral if np.isfinite(effect.neutral) else 0.0
    weak, strong = effect.weak - reference, effect.strong - reference
    # Log-uniform: a uniform draw would make most effects strong.
    deviation = weak * (strong / weak) ** rng.random()
    if effect.signed and rng.random() < 0.5:
        deviation = -deviation
    return float(f"{reference + deviation:.3g}")
