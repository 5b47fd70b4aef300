"""The draw of what each campaign hides: everything from one seed that the code under test never sees.

    hidden = draw_hidden(17, part="causes")
    record_hidden(folder, hidden)

Rule 1: consecutive seeds of `causes` go through all causes before one comes again, and through the three strengths of
        each within 78 seeds: a short run already says something about every cause.
Rule 2: sign, plant, noise and rig are drawn freely.
        `gateway` does so with the strong ones: its recordings take their time, because a real line carries them.
        `forms` goes through all formulas of `forms.py` before one comes again.
        `knock-out` goes through all causes, medium and strong in turn; `diagnose` is not told about the hidden one.
Rule 3: of effects that delay the loop a composite has one at most: two strong ones put the ball on the floor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gateway.emulator.plant.effects import EFFECTS, Effect
from tests.harness.diagnose.forms import FORMS
from tests.harness.diagnose.hidden_campaign import PlantName, make_campaign
from tests.harness.diagnose.outside import OUTSIDE

Part = Literal["causes", "nulls", "composites", "outside", "gateway", "forms", "knock-out"]
Grade = Literal["weak", "medium", "strong"]
PARTS: tuple[Part, ...] = get_args(Part)
GRADES: tuple[Grade, ...] = get_args(Grade)
DELAYING = frozenset({"actuation-delay", "eddy-current-lag", "position-sensor-lag", "sampling-delay"})
# A gain of the current sensor is exactly a change of K_A and K_c (design.md): asked alone, to hear "not testable".
INVISIBLE = frozenset({"current-sensor-gain"})
COUNTED = frozenset({"lost-samples"})  # not a cause that a fit finds
COUNTS = {"i_c": 5e-4, "x": 1.5e-6}  # of the converters: A, m
_DRAW = 26


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden:
    """A campaign to be recorded, and the truth about it."""

    part: Part
    seed: int  # of rig, noise, excitation
    plant: PlantName | Literal["gateway"]
    effects: Mapping[str, float] = field(default_factory=dict)
    form: str = ""  # of `forms`: the formula by which the one effect is written
    outside: Mapping[str, float] = field(default_factory=dict)
    grade: str = ""  # of `causes`
    without: tuple[str, ...] = ()  # of `knock-out`: what the catalogue lacks


def draw_hidden(seed: int, part: Part | None = None) -> Hidden:
    """The campaign of this seed.

    Args:
        seed: From 0.
        part: Which kind; default: drawn, half of them `causes`.
    """
    rng = np.random.default_rng([_DRAW, seed])
    kinds: tuple[Part, ...] = ("causes", "causes", "causes", "nulls", "composites", "outside")
    part = part or kinds[int(rng.integers(len(kinds)))]
    rng = np.random.default_rng([_DRAW, PARTS.index(part), seed])
    plant: PlantName = "emulator" if rng.random() < 0.5 else "independent"
    if part == "nulls":
        return Hidden(part=part, seed=seed, plant=plant)
    if part == "outside":
        names = sorted(OUTSIDE)
        name = names[seed % len(names)]
        strength = OUTSIDE[name].strength * 0.7 * 2.0 ** rng.random()
        return Hidden(part=part, seed=seed, plant="independent", outside={name: float(strength)})
    if part == "forms":
        names = sorted(FORMS)
        name = names[seed % len(names)]
        form = FORMS[name]
        value = float(form.medium * (form.strong / form.medium) ** rng.random())
        return Hidden(part=part, seed=seed, plant="textbook", effects={form.effect: value}, form=name, grade=name)
    names = np.random.default_rng(_DRAW).permutation(sorted(EFFECTS)).tolist()
    if part == "gateway":
        effect = EFFECTS[names[seed % len(names)]]
        effects = {effect.name: _signed(effect, effect.strong, rng)}
        return Hidden(part=part, seed=seed, plant="gateway", effects=effects, grade="strong")
    if part == "knock-out":
        names = [name for name in names if name not in INVISIBLE | COUNTED]
        turn, index = divmod(seed, len(names))
        effect, grade = EFFECTS[names[index]], GRADES[1 + (turn + index) % 2]
        effects = {effect.name: _signed(effect, getattr(effect, grade), rng)}
        return Hidden(part=part, seed=seed, plant=plant, effects=effects, grade=grade, without=(effect.name,))
    if part == "causes":
        turn, index = divmod(seed, len(names))
        effect, grade = EFFECTS[names[index]], GRADES[(turn + index) % len(GRADES)]
        value = getattr(effect, grade)
        return Hidden(
            part=part, seed=seed, plant=plant, effects={effect.name: _signed(effect, value, rng)}, grade=grade
        )
    chosen: dict[str, float] = {}
    for name in rng.permutation(sorted(set(names) - INVISIBLE)).tolist():
        if len(chosen) == 2 + seed % 2:
            break
        if not (name in DELAYING and DELAYING & chosen.keys()):
            chosen[name] = _between(EFFECTS[name], rng)
    return Hidden(part=part, seed=seed, plant=plant, effects=chosen)


def record_hidden(folder: Path, hidden: Hidden, *, quick: bool = False) -> None:
    """Write the campaign.

    Raises:
        Grounded: the ball does not fly with these effects.
        Refused: `campaign run` did not get to its end on this rig.
    """
    if hidden.plant == "gateway":
        # Imported here: zenoh and the daemon are for this part alone.
        from tests.harness.diagnose.through_gateway import record_through_gateway

        record_through_gateway(folder, hidden.effects, seed=hidden.seed, quick=quick)
        return
    make_campaign(
        folder,
        effects={hidden.form: next(iter(hidden.effects.values()))} if hidden.form else hidden.effects,
        seed=hidden.seed,
        plant=hidden.plant,
        quick=quick,
        outside=hidden.outside,
    )


def in_the_data(hidden: Hidden, folder: Path, *, quick: bool = False) -> bool:
    """Return whether the effect changes the recordings by more than 3 counts: same rig, noise and excitation.

    Args:
        hidden: One effect.
        folder: Receives the campaign twice.
        quick: Short campaigns.
    """
    record_hidden(folder / "with", hidden, quick=quick)
    record_hidden(folder / "without", replace(hidden, effects={}), quick=quick)
    return any(_differ(path, folder / "without" / path.name) for path in sorted((folder / "with").glob("*.csv.gz")))


def _differ(path: Path, other: Path) -> bool:
    """A closed loop makes volts out of one count of x: there x alone is compared."""
    first, second = (np.genfromtxt(file, delimiter=",", names=True) for file in (path, other))
    if len(first) != len(second):
        return True
    same_input = np.array_equal(first["u_c"], second["u_c"])
    columns = first.dtype.names or ()
    counts = {name: count for name, count in COUNTS.items() if name in columns and (name == "x" or same_input)}
    return any(
        float(np.nanmax(np.abs(first[name] - second[name]), initial=0.0)) > 3.0 * count
        for name, count in counts.items()
    )


def _signed(effect: Effect, value: float, rng: np.random.Generator) -> float:
    return 2.0 * effect.neutral - value if effect.signed and rng.random() < 0.5 else value


def _between(effect: Effect, rng: np.random.Generator) -> float:
    """Log-uniform between medium and strong, seen from the neutral value."""
    neutral = effect.neutral if np.isfinite(effect.neutral) else 0.0
    medium, strong = effect.medium - neutral, effect.strong - neutral
    return _signed(effect, float(neutral + medium * (strong / medium) ** rng.random()), rng)
