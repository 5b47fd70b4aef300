"""campaign.toml: what is right is understood, what is wrong is named with file, key, value and remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.campaign import Campaign, Column, Controller, OperatingPoint, Plant, load, parse
from protocol.errors import ConfigError, DataError

TEXT = """
[plant]
name = "ce152"
mass_kg = 8.28e-3
travel_m = 5.7e-3
[controller]
kind = "lqi"
gains = [0.49, 1700.0, 17.7, -17600.0]
operating_point = { i_c_a = 0.6, x_m = 2.85e-3, u_c_v = 2.1 }
[[recording]]
file = "amplifier_step.csv"
kind = "amplifier-step"
use = "fit"
[[recording]]
file = "run7.csv.gz"
kind = "closed-loop"
use = "judge"
skip_s = 3.0
columns = { t = "t_s", x = { column = "gap", scale = -1.0, offset = 0.02 }, u_c = { column = "duty", \
table = [[0.0, 0.043], [0.1, 0.613], [0.2, 1.768]] } }
"""


def changed(old: str, new: str) -> Campaign:
    assert old in TEXT
    return parse(TEXT.replace(old, new, 1), where="campaign.toml")


def test_everything_is_understood() -> None:
    campaign = parse(TEXT, where="campaign.toml")

    assert campaign.plant == Plant(name="ce152", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=5.7e-3, gravity_m_s2=9.81)
    assert campaign.controller == Controller(
        kind="lqi",
        gains=(0.49, 1700.0, 17.7, -17600.0),
        operating_point=OperatingPoint(i_c_a=0.6, x_m=2.85e-3, u_c_v=2.1),
    )
    step, run = campaign.recordings
    assert (step.kind, step.use, step.skip_s) == ("amplifier-step", "fit", 0.0)
    assert (run.kind, run.use, run.skip_s) == ("closed-loop", "judge", 3.0)
    assert step.column("i_c") == Column(column="i_c")
    assert run.column("t") == Column(column="t_s")
    assert run.column("x_ref") == Column(column="x_ref")
    assert run.column("x").convert(0.015) == pytest.approx(0.005)


def test_a_table_is_linear_between_and_beyond_its_points() -> None:
    column = Column(column="duty", table=((0.0, 0.0), (0.1, 1.0), (0.2, 3.0)))

    assert [column.convert(raw) for raw in (-0.1, 0.0, 0.05, 0.1, 0.15, 0.2, 0.3)] == pytest.approx(
        [-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 5.0]
    )
    assert [column.extrapolates(raw) for raw in (-0.1, 0.0, 0.2, 0.3)] == [True, False, False, True]


def test_the_controller_is_optional() -> None:
    text = TEXT[: TEXT.index("[controller]")] + TEXT[TEXT.index("[[recording]]") :]

    assert parse(text, where="campaign.toml").controller is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("mass_kg = 8.28e-3", "mass_g = 8.28", "plant.mass_kg is missing.*mass_g is not a key"),
        (
            "travel_m = 5.7e-3",
            "travel_m = 5.7",
            "plant.travel_m: 5.7 m is outside 0.1 mm .. 500 mm. You may mean 5.7 mm",
        ),
        (
            "mass_kg = 8.28e-3",
            "mass_kg = 8.28",
            r"plant.mass_kg: 8.28 kg is outside 0.1 g .. 2 kg. You may mean 8.28 g \(mass_kg = 0.00828\)",
        ),
        ("mass_kg = 8.28e-3", "mass_kg = 8.28e-6", "plant.mass_kg: 0.00828 g is outside"),
        (
            'name = "ce152"',
            "gravity_m_s2 = 981.0",
            "plant.gravity_m_s2: 981 m/s2 is outside 1 m/s2 .. 20 m/s2. You may mean 9.81 m/s2",
        ),
        ('"t_s"', '"t_ms"', r"columns.t = 't_ms' is in ms by its name, t is in s.*scale = 0.001"),
        ("mass_kg = 8.28e-3", 'mass_kg = "8.28e-3"', "plant.mass_kg = '8.28e-3' is not a finite number"),
        ("mass_kg = 8.28e-3", "mass_kg = nan", "plant.mass_kg = nan is not a finite number"),
        ("mass_kg = 8.28e-3", "mass_kg = true", "plant.mass_kg = True is not a finite number"),
        ('name = "ce152"', "gravity = 9.81", "plant.gravity = 9.81 is not a key.*gravity_m_s2"),
        ("[plant]", "[plnt]", "plant is missing"),
        ('kind = "lqi"', 'kind = "mpc"', r"controller.kind = 'mpc' is not one of lqi \| pid"),
        (", -17600.0]", "]", "controller.gains = .* is not a list of 4 numbers"),
        ("i_c_a = 0.6", "i_c = 0.6", "controller.operating_point.i_c_a is missing"),
        ('kind = "closed-loop"', 'kind = "closed"', r"recording 2 \(run7.csv.gz\).kind = 'closed'"),
        ('use = "judge"', "", r"recording 2 \(run7.csv.gz\).use is missing"),
        ("skip_s = 3.0", "skip_s = -1", "skip_s = -1 is not at least 0"),
        ("skip_s = 3.0", "skip = 3.0", "skip = 3.0 is not a key. Did you mean skip_s"),
        ('t = "t_s"', 'time = "t_s"', "columns.time = 't_s' is not a key"),
        ('t = "t_s"', "t = 3", "columns.t = 3 is not a column"),
        ("scale = -1.0", "scale = 0.0", "columns.x.scale = 0 makes every value equal"),
        ("scale = -1.0", "factor = 2.0", "columns.x.factor = 2.0 is not a key"),
        ("[0.1, 0.613]", "[0.0, 0.613]", r"columns.u_c.table 2 = \[0.0, 0.613\] does not rise"),
        ("[0.1, 0.613]", "[0.1]", r"table 2 = \[0.1\] is not a list of 2 numbers.*\[raw, value\]"),
        (
            "[[0.0, 0.043], [0.1, 0.613], [0.2, 1.768]]",
            "[[0.0, 0.043]]",
            r"\.table = .* is not a list of at least 2 lists.*pairs",
        ),
        ('file = "run7.csv.gz"', 'file = "amplifier_step.csv"', "used both to fit and to judge"),
        ('name = "ce152"', "name = ce152", "is not TOML.*line 3"),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        changed(old, new)

    assert str(caught.value).startswith("campaign.toml")
    assert caught.value.remedy
    assert caught.value.exit_code == 2


def test_a_campaign_without_recordings_is_none() -> None:
    with pytest.raises(ConfigError, match="recording is missing"):
        parse(TEXT[: TEXT.index("[[recording]]")], where="campaign.toml")


def test_recordings_lie_beside_the_campaign_or_in_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, shared = tmp_path / "rig", tmp_path / "shared"
    rig.mkdir()
    shared.mkdir()
    (rig / "campaign.toml").write_text(TEXT)
    (rig / "amplifier_step.csv").write_text("")
    (shared / "run7.csv.gz").write_text("")
    monkeypatch.delenv("BOARD51_DATA", raising=False)

    campaign = load(rig)
    step, run = campaign.recordings

    assert campaign.path_of(step) == rig / "amplifier_step.csv"
    assert campaign.path_of(run, data=shared) == shared / "run7.csv.gz"
    with pytest.raises(DataError, match=r"run7.csv.gz' is not at .*--data or BOARD51_DATA"):
        campaign.path_of(run)
    monkeypatch.setenv("BOARD51_DATA", str(shared))
    assert campaign.path_of(run) == shared / "run7.csv.gz"


@pytest.mark.parametrize(
    "name", ["../secret", "{outside}/secret", "link", "a/../../secret", "loop", "x" * 300, "a\\u0000b"]
)
def test_a_campaign_reaches_no_file_outside_its_folder(tmp_path: Path, name: str) -> None:
    rig, outside = tmp_path / "rig", tmp_path
    (rig / "a").mkdir(parents=True)
    (outside / "secret").write_text("x")
    (rig / "link").symlink_to(outside / "secret")
    (rig / "loop").symlink_to(rig / "loop")
    (rig / "campaign.toml").write_text(TEXT.replace("amplifier_step.csv", name.format(outside=outside)))

    campaign = load(rig)

    with pytest.raises(DataError, match=r"outside the campaign's folder|is not at") as error:
        campaign.path_of(campaign.recordings[0])
    assert "--data" in str(error.value)


def test_a_link_to_the_folder_that_the_user_names_is_followed(tmp_path: Path) -> None:
    rig, disk = tmp_path / "rig", tmp_path / "disk"
    rig.mkdir()
    disk.mkdir()
    (disk / "step.csv").write_text("")
    (rig / "amplifier_step.csv").symlink_to(disk / "step.csv")
    (rig / "campaign.toml").write_text(TEXT)

    campaign = load(rig)

    assert campaign.path_of(campaign.recordings[0], data=disk) == rig / "amplifier_step.csv"


@pytest.mark.parametrize(("content", "says"), [(None, "cannot be read"), (b"\xff\xfe", "not UTF-8 text")])
def test_a_file_that_is_none_is_told(tmp_path: Path, content: bytes | None, says: str) -> None:
    if content is not None:
        (tmp_path / "campaign.toml").write_bytes(content)

    with pytest.raises(DataError, match=says):
        load(tmp_path)
