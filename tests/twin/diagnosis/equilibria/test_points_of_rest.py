"""Points of rest alone: recover what was put in, name no more than the points hold, say what would split a class."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from board51 import main
from protocol.campaign import Campaign, Plant
from protocol.errors import DataError
from twin.api.results import as_text
from twin.diagnosis.equilibria.diagnosis import diagnose_points
from twin.diagnosis.equilibria.points import f_test, fit_static, holding_currents, interval, points_of, rounding
from twin.diagnosis.equilibria.to_json import to_json
from twin.estimation.record import Record
from twin.model.parameters import Model

Answer = tuple[int, dict[str, Any]]
MASS_KG, GRAVITY_M_S2, TRAVEL_M = 8.28e-3, 9.81, 5.7e-3
K_C = 5e-6
PLANT = Plant(name="ce152", mass_kg=MASS_KG, travel_m=TRAVEL_M, x_max_m=TRAVEL_M, gravity_m_s2=GRAVITY_M_S2)


def balance(x_m: float, *, d_m: float = 0.0) -> float:
    """Current that holds the ball, by (3) with the coil d above x_max, A: written here from the paper."""
    return (TRAVEL_M + d_m - x_m) * math.sqrt(MASS_KG * GRAVITY_M_S2 / K_C)


def record(x_m: list[float], i_c_a: list[float], u_c_v: list[float] | None = None) -> Record:
    n = len(x_m)
    return Record(
        name="rest.csv",
        kind="equilibria",
        use="fit",
        t=np.arange(float(n)),
        u_c=np.array(u_c_v) if u_c_v else np.full(n, np.nan),
        i_c=np.array(i_c_a),
        x=np.array(x_m),
        x_ref=np.full(n, np.nan),
    )


def heights(count: int) -> list[float]:
    return [0.6e-3 + 4.4e-3 * n / (count - 1) for n in range(count)]


def noisy(count: int, current: Callable[[float], float], *, sigma_a: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    x = heights(count)
    return record(x, [current(at) + float(rng.normal(0.0, sigma_a)) for at in x])


def campaign_of(plant: Plant) -> Campaign:
    return Campaign(where="campaign.toml", folder=Path(), plant=plant, controller=None, recordings=())


def test_the_paper_model_comes_back_from_its_own_points() -> None:
    points = points_of([record(heights(5), [balance(x) for x in heights(5)])], PLANT)

    fit = fit_static(points, PLANT)

    assert fit.theta.K_c == pytest.approx(K_C, rel=1e-6)
    assert np.allclose(fit.residual_a, 0.0, atol=1e-8)


def test_the_interval_is_that_of_the_straight_line() -> None:
    """With a coil offset i_c is a straight line in x: its F interval is Fieller's, known in closed form."""
    points = points_of([noisy(6, lambda x: balance(x, d_m=2e-3), sigma_a=4e-3, seed=1)], PLANT)
    fit = fit_static(points, PLANT, "air-gap-offset")

    low, high = interval(points, PLANT, fit)

    assert low < 2e-3 < high
    assert f_test(fit_static(points, PLANT), fit)[1] < 0.01
    gap, i, n = TRAVEL_M - points.x_m, points.i_c_a, len(points)
    best = np.polynomial.polynomial.polyfit(gap, i, 1)
    rss = float(np.sum((i - np.polynomial.polynomial.polyval(gap, best)) ** 2))
    assert fit.theta.value("air-gap-offset.d_m") == pytest.approx(best[0] / best[1], rel=1e-4)
    for end in (low, high):
        slope = float(np.sum(i * (gap + end)) / np.sum((gap + end) ** 2))
        held = float(np.sum((i - slope * (gap + end)) ** 2))
        assert held == pytest.approx(rss * (1.0 + 7.7086 / (n - 2)), rel=0.01)  # F(1, 4) at 95 %


@pytest.mark.sample
def test_noise_alone_seldom_names_a_cause() -> None:
    named = 0
    for seed in range(12):
        diagnosis = diagnose_points(campaign_of(PLANT), [noisy(6, balance, sigma_a=4e-3, seed=100 + seed)], [])
        named += diagnosis.verdict == "causes-found"

    assert named <= 3  # of 12 at 5 %: more has a chance of 0.2 %


@pytest.mark.slow
def test_a_coil_plane_too_high_is_within_its_interval() -> None:
    covered = 0
    for seed in range(12):
        points = points_of([noisy(6, lambda x: balance(x, d_m=2e-3), sigma_a=4e-3, seed=seed)], PLANT)
        low, high = interval(points, PLANT, fit_static(points, PLANT, "air-gap-offset"))
        covered += low <= 2e-3 <= high

    assert covered >= 9  # of 12 at 95 %: fewer has a chance of 0.2 %


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, dict[str, Any], Path]:
    """Exit code, diagnosis and folder of the answer for a coil that sits 2 mm higher."""
    folder: Path = tmp_path_factory.mktemp("shifted")
    x = heights(6)
    return *diagnosed(folder, x, [round(balance(at, d_m=2e-3), 3) for at in x]), folder / "out"


def test_the_class_is_told_apart_by_the_pole(shifted: tuple[int, dict[str, Any], Path]) -> None:
    code, report, _ = shifted

    assert code == 0
    (cause,) = report["causes"]
    assert cause["name"] == "air-gap-offset"
    assert cause["parameters"]["d_m"]["value"] == pytest.approx(2e-3, abs=2e-5)
    gap = TRAVEL_M / 2.0 + 2e-3
    assert cause["unstable_pole_per_s"] == pytest.approx(math.sqrt(2.0 * GRAVITY_M_S2 / gap), rel=0.01)
    assert "current-sensor-offset" in cause["indistinguishable_from"]
    assert cause["next_experiment"]["separation_z"] > 3.0
    assert report["gain"]["leave_one_out"]["ratio"] < 0.05
    assert report["gain"]["judge"] is None


def test_what_cannot_show_at_rest_is_said_so(shifted: tuple[int, dict[str, Any], Path]) -> None:
    _, report, _ = shifted

    why = {entry["name"]: entry["why"] for entry in report["not_testable"]}
    assert {"quadratic-drag", "actuation-delay", "current-sensor-gain"} <= set(why)
    assert "K_c" in why["constant-force"]
    assert "measured" in why["amplifier-offset"]


def test_the_extended_model_runs_and_says_what_was_not_measured(shifted: tuple[int, dict[str, Any], Path]) -> None:
    _, _, out = shifted

    model = Model.load(out / "extended_model.json")

    assert [cause.name for cause in model.causes] == ["air-gap-offset"]
    assert model.parameters["T_A"].verdict == "assumed"
    low, high = model.parameters["K_c"].ci95 or (0.0, 0.0)
    assert low < K_C < high
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "air-gap-offset" in page
    assert "data:image/svg+xml;base64," in page


@pytest.mark.slow
def test_a_bent_balance_is_no_shifted_coil(tmp_path: Path) -> None:
    """The current follows gap^0.75 (force exponent 1.5): a straight line does not."""
    x = heights(9)
    currents = [0.4 * ((TRAVEL_M - at) / 2.85e-3) ** 0.75 for at in x]

    _, report = diagnosed(tmp_path, x, currents)

    (cause,) = report["causes"]
    assert cause["name"] == "force-exponent"
    assert cause["parameters"]["n"]["value"] == pytest.approx(1.5, abs=0.01)
    assert "air-gap-offset" not in cause["indistinguishable_from"]
    assert "air-gap-offset" in {entry["name"] for entry in report["ruled_out"]}


def test_three_points_name_nothing_but_say_what_is_near(tmp_path: Path) -> None:
    x = heights(3)
    bend = (2e-3, -4e-3, 2e-3)

    code, report = diagnosed(
        tmp_path, x, [round(balance(at, d_m=2e-3) + off, 3) for at, off in zip(x, bend, strict=True)]
    )

    assert code == 1
    assert report["verdict"] == "unknown-cause"
    assert report["causes"] == []
    assert "too few" in report["sentence"]


@pytest.mark.slow
def test_a_current_computed_from_the_input_blames_the_amplifier_too(tmp_path: Path) -> None:
    x = heights(6)
    u = [round(balance(at, d_m=2e-3) / 0.3, 3) for at in x]

    _, report = diagnosed(tmp_path, x, [0.3 * volts for volts in u], u)

    assert {"amplifier-offset", "amplifier-dead-zone"} & set(report["causes"][0]["indistinguishable_from"])
    assert any("computed" in warning for warning in report["warnings"])
    assert report["gain"]["leave_one_out"]["noise_floor_a"] == pytest.approx(0.3e-3 / math.sqrt(12.0))


def test_judge_points_are_left_out_and_judged(tmp_path: Path) -> None:
    x = heights(9)
    i = [balance(at, d_m=2e-3) for at in x]
    write(tmp_path / "judge.csv", x[1::2], i[1::2])

    _, report = diagnosed(
        tmp_path, x[::2], i[::2], more='\n[[recording]]\nfile = "judge.csv"\nkind = "equilibria"\nuse = "judge"\n'
    )

    assert report["gain"]["judge"]["baseline_rmse_a"] > 0.05
    assert report["gain"]["judge"]["extended_rmse_a"] < 1e-4


@pytest.mark.parametrize(
    ("x", "i", "says"),
    [
        ([1e-3, 2e-3], [0.5, 0.4], "too few"),
        ([1.0, 2.0, 3.0], [0.5, 0.4, 0.3], "x is"),
        ([1e-3, 2e-3, 3e-3], [0.5, -0.4, 0.3], "cannot hold the ball"),
        ([1e-3, 1.01e-3, 1.02e-3], [0.5, 0.5, 0.5], "too few"),
    ],
)
def test_points_that_cannot_be_are_refused(x: list[float], i: list[float], says: str) -> None:
    with pytest.raises(DataError, match=says):
        points_of([record(x, i)], PLANT)


@pytest.mark.slow
def test_a_cause_without_an_unstable_pole_leaves_the_file_readable() -> None:
    records = [noisy(8, lambda x: balance(x, d_m=2e-3), sigma_a=1e-4, seed=1)]
    diagnosis = diagnose_points(campaign_of(PLANT), records, [])
    stable = replace(diagnosis, members=tuple(replace(member, pole_per_s=math.nan) for member in diagnosis.members))

    data = json.loads(as_text(to_json(stable)))

    assert data["causes"][0]["unstable_pole_per_s"] is None


def test_rounding_is_read_off_the_digits() -> None:
    assert rounding(np.array([2.87, 2.34, 1.9])) == pytest.approx(0.01)
    assert rounding(np.array([1.0, 2.0])) == pytest.approx(1.0)
    assert rounding(np.array([math.pi, math.e])) == 0.0


def test_a_force_that_helps_takes_its_part_of_the_current() -> None:
    theta = fit_static(points_of([record(heights(5), [balance(x) for x in heights(5)])], PLANT), PLANT).theta
    weight = MASS_KG * GRAVITY_M_S2

    helped = holding_currents(theta.having("constant-force.force_n", 0.05), PLANT, np.array([1e-3]))

    assert helped[0] == pytest.approx(balance(1e-3) * math.sqrt(1.0 - 0.05 / weight), rel=1e-6)


def write(path: Path, x: list[float], i: list[float], u: list[float] | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"{a!r},{b!r}" + (f",{u[n]!r}" if u else "") for n, (a, b) in enumerate(zip(x, i, strict=True))]
    path.write_text("x,i_c" + (",u_c" if u else "") + "\n" + "\n".join(rows) + "\n", encoding="utf-8")


def diagnosed(folder: Path, x: list[float], i: list[float], u: list[float] | None = None, more: str = "") -> Answer:
    """`board51 diagnose` on these points: (exit code, diagnosis.json)."""
    write(folder / "rest.csv", x, i, u)
    (folder / "campaign.toml").write_text(
        f'[plant]\nname = "ce152"\nmass_kg = {MASS_KG}\ntravel_m = {TRAVEL_M}\n\n'
        f'[[recording]]\nfile = "rest.csv"\nkind = "equilibria"\nuse = "fit"\n{more}',
        encoding="utf-8",
    )
    code = main(["diagnose", str(folder), "--out", str(folder / "out"), "--quiet"])
    return code, json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
