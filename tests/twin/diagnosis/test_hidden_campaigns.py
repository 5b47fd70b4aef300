"""A hidden campaign is a campaign as users have one, and tells nothing of what is hidden in it."""

from __future__ import annotations

import gzip
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gateway.emulator.plant.effects import EFFECTS
from protocol.campaign import load
from tests.harness.diagnose.draws import (
    DELAYING,
    GRADES,
    INVISIBLE,
    PARTS,
    Hidden,
    draw_hidden,
    in_the_data,
    record_hidden,
)
from tests.harness.diagnose.hidden_campaign import Grounded, PlantName, draw_rig, make_campaign
from twin.identification.pipeline import identify
from twin.readers.campaign import read_campaign

pytestmark = pytest.mark.slow  # the campaigns are those of slow tests
PLANTS: tuple[PlantName, ...] = ("emulator", "independent")
SEED = 8675309
DRAG = {"quadratic-drag": 4.0}


@pytest.fixture(scope="module", params=PLANTS)
def plant(request: pytest.FixtureRequest) -> PlantName:
    name: PlantName = request.param
    return name


@pytest.fixture(scope="module")
def none(plant: PlantName, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with nothing hidden."""
    folder: Path = tmp_path_factory.mktemp("none") / "campaign"
    make_campaign(folder, effects={}, seed=SEED, plant=plant, quick=True)
    return folder


@pytest.fixture(scope="module")
def drag(plant: PlantName, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of the same rig with an effect."""
    folder: Path = tmp_path_factory.mktemp("drag") / "campaign"
    make_campaign(folder, effects=DRAG, seed=SEED, plant=plant, quick=True)
    return folder


def test_the_folder_does_not_tell_effect_or_seed(none: Path, drag: Path, plant: PlantName) -> None:
    assert {path.name for path in none.iterdir()} == {path.name for path in drag.iterdir()}
    assert (none / "campaign.toml").read_bytes() == (drag / "campaign.toml").read_bytes()
    for path in drag.iterdir():
        # No name and no time in the gzip header (bytes 3 to 7), no word of the effect inside.
        raw = path.read_bytes()
        assert path.suffix == ".toml" or raw[3:8] == bytes(5)
        text = (raw if path.suffix == ".toml" else gzip.decompress(raw)).decode()
        assert not any(word in text for word in ("drag", str(SEED), "effect", plant))


def test_the_seed_gives_the_bytes(drag: Path, tmp_path: Path, plant: PlantName) -> None:
    for name, seed in (("again", SEED), ("other", 6)):
        make_campaign(tmp_path / name, effects=DRAG, seed=seed, plant=plant, quick=True)

    first, again, other = (
        {path.name: path.read_bytes() for path in folder.iterdir()}
        for folder in (drag, tmp_path / "again", tmp_path / "other")
    )
    assert first == again
    assert all(first[name] != other[name] for name in first)


def test_without_an_effect_the_truth_comes_back(none: Path, plant: PlantName) -> None:
    rig = draw_rig(SEED, plant)

    parameters = identify(load(none)).model.parameters

    for name, true in (("K_c", rig.force_constant_n_m2_a2), ("T_A", rig.amplifier_time_constant_s)):
        estimate = parameters[name]
        assert estimate.std is not None
        assert abs(estimate.value - true) < 5.0 * estimate.std, name
    # the converter cuts the noise of i_c in half at 0 A, which lifts K_A by more than its own error
    assert parameters["K_A"].value == pytest.approx(rig.amplifier_gain_a_v, rel=5e-4)


def test_one_board_clock_runs_through_the_campaign(none: Path) -> None:
    campaign = load(none)

    fit, judge = (read_campaign(campaign, use=use) for use in ("fit", "judge"))

    spans = sorted((record.t[0], record.t[-1]) for record in fit + judge)
    assert all(end < start for (_, end), (start, _) in pairwise(spans))
    assert all(np.all(np.diff(record.t) > 0) for record in fit + judge)
    recorded = sum(end - start for start, end in spans)
    assert 28.0 < recorded < 32.0  # a third of what a campaign is that is not quick
    kinds = Counter((record.kind, record.use) for record in fit + judge)
    assert kinds == {
        ("free", "fit"): 1,
        ("amplifier-step", "fit"): 5,
        ("amplifier-step", "judge"): 1,
        ("sawtooth", "fit"): 1,
        ("prbs", "fit"): 1,
        ("closed-loop", "fit"): 4,
        ("closed-loop", "judge"): 4,
    }


def test_an_effect_may_begin_with_a_recording(none: Path, tmp_path: Path, plant: PlantName) -> None:
    strong = {"current-sensor-offset": 0.08}
    make_campaign(tmp_path, effects=strong, seed=SEED, plant=plant, quick=True, begins_with="closed_loop_3")

    usual, changed = (read_campaign(load(folder)) for folder in (none, tmp_path))
    means = {b.name: float(np.mean(b.i_c) - np.mean(a.i_c)) for a, b in zip(usual, changed, strict=True)}
    assert means.pop("closed_loop_3.csv.gz") == pytest.approx(0.08, abs=5e-3)
    assert means.pop("closed_loop_4.csv.gz") == pytest.approx(0.08, abs=5e-3)
    assert set(means.values()) == {0.0}


def test_x_max_may_be_the_travel_as_in_the_paper(tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={}, seed=2, plant="independent", quick=True, x_max="travel")

    plant = load(tmp_path).plant

    assert plant.x_max_m == plant.travel_m


def test_effects_that_ground_the_ball_are_said_and_nothing_is_written(tmp_path: Path) -> None:
    delays = {name: EFFECTS[name].high for name in ("actuation-delay", "sampling-delay")}

    with pytest.raises(Grounded):
        make_campaign(tmp_path / "none", effects=delays, seed=1, plant="independent", quick=True)

    assert not (tmp_path / "none").exists()


def test_consecutive_seeds_go_through_the_whole_table() -> None:
    drawn = [draw_hidden(seed, "causes") for seed in range(78)]

    assert {name for hidden in drawn[26:52] for name in hidden.effects} == set(EFFECTS)
    cells = Counter((*hidden.effects, hidden.grade) for hidden in drawn)
    assert cells == {(name, grade): 1 for name in EFFECTS for grade in GRADES}
    assert {hidden.plant for hidden in drawn} == set(PLANTS)
    for hidden in drawn:
        ((name, value),) = hidden.effects.items()
        effect = EFFECTS[name]
        strength = getattr(effect, hidden.grade)
        assert value in (strength, 2.0 * effect.neutral - strength if effect.signed else strength)
    mirrored = [h for h in drawn for n, v in h.effects.items() if v != getattr(EFFECTS[n], h.grade)]
    assert mirrored


def test_composites_hold_two_or_three_visible_causes_and_one_delay_at_most() -> None:
    drawn = [draw_hidden(seed, "composites") for seed in range(60)]

    assert Counter(len(hidden.effects) for hidden in drawn) == {2: 30, 3: 30}
    for hidden in drawn:
        assert len(DELAYING & hidden.effects.keys()) <= 1
        assert not INVISIBLE & hidden.effects.keys()


def test_a_seed_alone_draws_of_every_part_and_always_the_same() -> None:
    drawn = [draw_hidden(seed) for seed in range(60)]

    assert {hidden.part for hidden in drawn} == set(PARTS) - {"gateway", "forms", "knock-out"}
    assert drawn == [draw_hidden(seed) for seed in range(60)]


def test_composites_can_be_recorded(tmp_path: Path) -> None:
    record_hidden(tmp_path / "both", draw_hidden(0, "composites"), quick=True)

    assert load(tmp_path / "both").recordings


@pytest.mark.parametrize(("limit_a", "visible"), [(0.9, True), (1.5, False)])
def test_a_limit_is_in_the_data_where_it_was_reached(tmp_path: Path, limit_a: float, visible: bool) -> None:
    hidden = Hidden(part="causes", seed=3, plant="emulator", effects={"current-limit": limit_a})

    assert in_the_data(hidden, tmp_path) is visible
