"""campaign.toml written: what is read back is what was written, to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.campaign import (
    CHANNELS,
    KINDS,
    Campaign,
    Column,
    Controller,
    Law,
    OperatingPoint,
    Plant,
    Recording,
    Use,
    load_plant,
    parse,
)
from protocol.campaign_text import emit
from protocol.errors import ConfigError, DataError
from tests.examples import costly

finite = st.floats(allow_nan=False, allow_infinity=False)
words = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
lengths = st.floats(1e-4, 0.5)

plants = lengths.flatmap(
    lambda travel_m: st.builds(
        Plant, name=words, mass_kg=st.floats(1e-4, 2.0), travel_m=st.just(travel_m), x_max_m=st.floats(travel_m, 0.5),
        gravity_m_s2=st.floats(1.0, 20.0), assumed=st.booleans(), ball_diameter_m=st.none() | st.floats(1e-3, 0.1),
    )
)  # fmt: skip
controllers = st.builds(
    Controller, kind=st.sampled_from(get_args(Law)), gains=st.tuples(finite, finite, finite, finite),
    operating_point=st.builds(OperatingPoint, i_c_a=finite, x_m=finite, u_c_v=finite),
)  # fmt: skip
tables = st.one_of(
    st.just(()),
    st.lists(st.tuples(finite, finite), min_size=2, max_size=4, unique_by=lambda point: point[0]).map(
        lambda points: tuple(sorted(points))
    ),
)
columns = st.builds(Column, column=words, scale=finite.filter(lambda value: value != 0.0), offset=finite, table=tables)
recordings = st.builds(
    Recording, file=words, kind=st.sampled_from(KINDS), use=st.sampled_from(get_args(Use)), skip_s=st.floats(0.0, 1e6),
    instrument=st.one_of(st.just(""), words), board=st.one_of(st.just(""), words),
    columns=st.dictionaries(st.sampled_from(CHANNELS), columns, max_size=3),
)  # fmt: skip
campaigns = st.builds(
    Campaign, where=st.just("campaign.toml"), folder=st.just(Path()), plant=plants,
    controller=st.one_of(st.none(), controllers),
    recordings=st.lists(recordings, min_size=1, max_size=4, unique_by=lambda r: r.file).map(tuple),
)  # fmt: skip


@settings(max_examples=costly(40))
@given(campaign=campaigns)
def test_what_is_written_is_read_back(campaign: Campaign) -> None:
    text = emit(campaign, comments=["how it came about"])

    assert parse(text, where="campaign.toml") == campaign
    assert text.startswith("# how it came about\n")


def test_a_plant_alone_is_enough_for_its_reader(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text("[plant]\nmass_kg = 8.28e-3\ntravel_m = 5.7e-3\nx_max_m = 8.1e-3\n")

    plant = load_plant(file)

    assert (plant.mass_kg, plant.travel_m, plant.x_max_m) == (8.28e-3, 5.7e-3, 8.1e-3)


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("", ConfigError, "plant is missing"),
        ("[plant]\nmass_kg = 8.28e-3\n", ConfigError, "travel_m is missing"),
        ("[plant", ConfigError, "is not TOML"),
    ],
)
def test_a_plant_that_is_none_is_named(text: str, error: type[Exception], says: str, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(text)

    with pytest.raises(error, match=says):
        load_plant(file)


def test_an_absent_plant_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"absent\.toml cannot be read"):
        load_plant(tmp_path / "absent.toml")


def test_a_scale_of_one_is_written_where_the_name_says_another_unit() -> None:
    recording = Recording(file="a.csv", kind="free", use="fit", columns={"x": Column(column="x_mm", scale=1.0)})
    plant = Plant(name="rig", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=5.7e-3, gravity_m_s2=9.81)
    campaign = Campaign(where="campaign.toml", folder=Path(), plant=plant, controller=None, recordings=(recording,))

    assert parse(emit(campaign), where="campaign.toml") == campaign
