"""`board51 compare`: the better model, the flight that differs, the parameter that drifts, and the refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import board51
from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152
from protocol.errors import DataError
from protocol.wire.messages import Shape
from tests.harness.twin.emulated_campaign import Lab
from tests.harness.twin.true_model import true_model
from twin.comparison.comparison import Comparison, compare_flights, compare_models, compare_over_time
from twin.comparison.errors import WHOLE, Totals
from twin.comparison.parameters import courses
from twin.estimation.record import Record, day_of
from twin.model.parameters import Model

NAMES = ("t", "u_c", "i_c", "x", "x_ref")


def fly(effects: dict[str, float], seed: int, *, ticks: int = 6000) -> Record:
    lab = Lab(CE152, effects=effects, seed=seed)
    lab.fly()
    lab.run(300)
    span, middle = POSITION.span(0.7e-3), POSITION.to_count(2.85e-3)
    lab.excite(Shape.MULTISINE, on_reference=True, amplitude=span, offset=middle, period=1000, seed=seed)
    return lab.record(f"flight-{seed}", "closed-loop", ticks)


def with_values(model: Model, day: str, values: dict[str, float]) -> Model:
    parameters = {
        key: replace(entry, value=values.get(key, entry.value), ci95=None) for key, entry in model.parameters.items()
    }
    return replace(model, parameters=parameters, provenance={"measured": day})


def write(folder: Path, name: str, record: Record) -> Path:
    table = np.column_stack([getattr(record, channel) for channel in NAMES])
    np.savetxt(folder / name, table, delimiter=",", header=",".join(NAMES), comments="", fmt="%.12g")
    return folder / name


@pytest.fixture(scope="module")
def high_coil() -> Record:
    return fly({"air-gap-offset": 4e-4}, 5)


def test_the_model_that_knows_the_effect_predicts_better(high_coil: Record) -> None:
    models = (true_model(), true_model(effects={"air-gap-offset": 4e-4}))
    comparison = compare_models(models, [high_coil])
    whole = [change for change in comparison.changes if change.region == WHOLE]
    assert [round(change.horizon_s * 1e3) for change in whole] == [2, 10, 20, 40]
    at_20_ms = whole[2]
    assert at_20_ms.significant
    assert at_20_ms.ci95[1] < 0.8
    assert at_20_ms.ci95[0] < at_20_ms.ratio < at_20_ms.ci95[1]
    assert comparison.answer().startswith("emulated + air-gap-offset predicts better. ")


@pytest.mark.slow
def test_equal_models_do_not_differ(high_coil: Record) -> None:
    comparison = compare_models((true_model(), true_model()), [high_coil])
    assert not comparison.differs
    assert comparison.names == ("emulated (no. 1)", "emulated (no. 2)")


@pytest.mark.slow
def test_a_rig_that_changed_between_two_flights_is_seen() -> None:
    unlike = compare_flights(true_model(), [fly({}, 1), fly({"air-gap-offset": 4e-4}, 2)])
    assert unlike.differs
    assert unlike.answer().startswith("The model predicts flight-1 better. ")


@pytest.mark.sample
def test_flights_of_one_rig_seldom_differ() -> None:
    """Three pairs: at 5 % for each, two that differ have a chance of 0.7 %."""
    flights = [fly({}, seed, ticks=2500) for seed in range(1, 7)]
    pairs = zip(flights[::2], flights[1::2], strict=True)
    assert sum(compare_flights(true_model(), pair).differs for pair in pairs) < 2


def test_the_interval_of_a_ratio_holds_the_truth_as_often_as_stated() -> None:
    """Equal errors with blocks of random size and correlated sides: 95 % of 400 intervals, within 4 sigma."""
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(400):
        common = rng.gamma(3.0, size=40)
        sides = [Totals(squares=common * rng.chisquare(20, 40), counts=np.full(40, 500.0)) for _ in range(2)]
        ratio = np.log(sides[1].squares.sum() / sides[0].squares.sum())
        covered += abs(ratio) < 2.02 * sides[1].relative_spread(sides[0])
    assert abs(covered / 400 - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 400)


def test_a_drift_is_found_and_dated() -> None:
    model = true_model()
    drift = [
        with_values(model, f"2026-{month:02}-03", {"K_c": model.K_c * (1.0 - 0.03 * n)})
        for n, month in enumerate((9, 10, 11))
    ]
    comparison = compare_over_time([drift[2], drift[0], drift[1]])
    assert comparison.days == ("2026-09-03", "2026-10-03", "2026-11-03")
    assert [parameter.name for parameter in comparison.parameters if parameter.significant] == ["K_c"]
    assert comparison.answer() == (
        "K_c changed by -6 % from first to last (-8.77 .. -3.23 %). No other parameter changed significantly."
    )


def test_no_drift_is_found_where_there_is_none() -> None:
    """Four parameters over five models, 400 times: in 5 % of them one changes, within 4 sigma."""
    rng, model = np.random.default_rng(7), true_model()
    stds = {name: entry.std or 0.0 for name, entry in model.parameters.items()}
    wrong = 0
    for _ in range(400):
        draws = []
        for _ in range(5):
            values = {name: entry.value + rng.normal(0.0, stds[name]) for name, entry in model.parameters.items()}
            draws.append(with_values(model, "", values))
        wrong += any(entry.significant for entry in courses(draws))
    assert abs(wrong / 400 - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 400)


def test_models_of_two_rigs_are_refused() -> None:
    with pytest.raises(DataError, match=r"mass_kg is 0.00828 in emulated and 0.02 in emulated: they"):
        compare_over_time([true_model(), true_model(replace(CE152, mass_kg=0.02))])


def test_flights_at_two_sampling_times_are_refused(high_coil: Record) -> None:
    slow = replace(high_coil, t=2.0 * high_coil.t)
    with pytest.raises(DataError, match=r"flight-5 is sampled every 2 ms, flight-5 every 4 ms. Compare flights of one"):
        compare_flights(true_model(), [high_coil, slow])


@pytest.mark.slow
def test_a_page_and_its_numbers(tmp_path: Path, high_coil: Record, capsys: pytest.CaptureFixture[str]) -> None:
    for name, effects in (("a", {}), ("b", {"air-gap-offset": 4e-4})):
        with_name = replace(true_model(effects=effects), provenance={"name": f"model <{name}>"})
        with_name.save(tmp_path / f"{name}.json")
    flight = write(tmp_path, "flight.csv", high_coil)
    out = tmp_path / "out"
    sides = [str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert board51.main(["compare", *sides, "--on", str(flight), "--out", str(out), "--quiet"]) == 0
    assert "model <b> predicts better." in capsys.readouterr().out
    numbers = json.loads((out / "compare.json").read_text())
    assert numbers["names"] == ["model <a>", "model <b>"]
    page = (out / "compare.html").read_text()
    assert "model &lt;b&gt; predicts better." in page
    assert "data:image/svg+xml" in page


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ce152"], "one side alone"),
        (["ce152", "ce152", "ce152", "--on", "x.csv"], "3 given where two models are compared"),
        (["a.csv", "--under", "ce152"], "1 given where two flights are compared"),
        (["ce152", "ce152", "--on", "x.csv", "--under", "ce152"], "--on and --under exclude each other"),
        (["ce152", "inteco"], "they describe different rigs"),
        (["ce152", "nowhere.json"], "nowhere.json"),
    ],
)
def test_refusals(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["compare", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_the_day_of_a_model_is_that_of_its_first_log(high_coil: Record) -> None:
    later = replace(high_coil, began_ns=1_800_000_000_000_000_000)
    assert day_of([later, replace(later, began_ns=later.began_ns - 10**14)]) == {"measured": "2027-01-14"}
    assert day_of([high_coil]) == {}


def test_the_name_of_a_model() -> None:
    model = true_model(effects={"air-gap-offset": 4e-4})
    assert model.name == "emulated + air-gap-offset"
    assert replace(model, provenance={"measured": "2026-11-24"}).name == "emulated + air-gap-offset, 24 Nov 2026"
    assert replace(model, provenance={"name": "cold Monday", "measured": "2026-11-24"}).name == "cold Monday"
    assert replace(model, provenance={"name": "a\x1b[2J"}).name == "emulated + air-gap-offset"
    many = true_model(
        effects={name: 0.01 for name in ("motional-emf", "air-gap-offset", "quadratic-drag", "constant-force")}
    )
    assert many.name == "emulated + motional-emf + air-gap-offset + 2 more"


def test_a_comparison_without_data_says_so() -> None:
    empty = Comparison(kind="flights", names=("a", "b"), days=("", ""), flights=(), changes=(), parameters=(), notes=())
    assert "too short" in empty.answer()
