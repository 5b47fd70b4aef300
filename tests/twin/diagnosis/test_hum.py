"""Mains in the position sensor, and a shaken table, of a rig that shares no equation with the twin."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose

LINE, HUM_M, HUM_HZ = "position-sensor-line", 20e-6, 50.0


@pytest.mark.sample
@pytest.mark.parametrize("octave_m", [0.0, 8e-6], ids=["pure", "with an octave"])
def test_mains_in_x_are_named_and_predicted(tmp_path: Path, octave_m: float) -> None:
    make_campaign(
        tmp_path,
        effects={},
        seed=3,
        plant="independent",
        outside={"sensor-hum": HUM_M, "sensor-hum-octave": octave_m},
    )

    diagnosis = diagnose(load(tmp_path / "campaign.toml"))

    assert diagnosis.verdict == "causes-found"
    assert [cause.name for cause in diagnosis.causes] == [LINE]
    line, answer = diagnosis.lines
    assert (line.channel, line.cause) == ("x", LINE)
    assert (answer.channel, answer.cause, answer.amplitude.unit) == ("u_c", LINE, "V")
    assert line.frequency_hz.value == pytest.approx(HUM_HZ, abs=3e-3)
    assert line.amplitude.value == pytest.approx(HUM_M, rel=0.03)
    assert line.amplitude.ci95 is not None
    assert line.amplitude.ci95[1] - line.amplitude.ci95[0] < 0.1 * HUM_M
    assert diagnosis.causes[0].parameters["harmonic_2"].value == pytest.approx(octave_m / HUM_M, abs=0.05)
    assert "in its sensor, not in the force" in diagnosis.sentence
    assert diagnosis.gain is not None
    assert diagnosis.gain.removed > 0.9


@pytest.mark.slow
def test_a_harmonic_of_a_periodic_force_is_no_second_cause(tmp_path: Path) -> None:
    effects, octave = {"periodic-disturbance": 3e-3}, {"shake-octave": 0.4}
    make_campaign(tmp_path, effects=effects, seed=13601, plant="independent", outside=octave, quick=True)

    diagnosis = diagnose(load(tmp_path / "campaign.toml"), Options(quick=True))

    assert diagnosis.verdict == "causes-found"
    (cause,) = diagnosis.causes
    assert cause.name == "periodic-disturbance"
    sizes = {name: parameter.value for name, parameter in cause.parameters.items()}
    assert sizes["amplitude_n"] == pytest.approx(3e-3, rel=0.05)
    assert math.hypot(sizes["sine_2"], sizes["cosine_2"]) == pytest.approx(0.4, rel=0.1)


@pytest.mark.sample
def test_a_cause_beside_mains_is_named_with_its_size(tmp_path: Path) -> None:
    lag_s = 2e-3
    effects, mains = {"position-sensor-lag": lag_s}, {"sensor-hum": HUM_M}
    make_campaign(tmp_path, effects=effects, seed=5, plant="independent", outside=mains, quick=True)

    diagnosis = diagnose(load(tmp_path / "campaign.toml"))

    assert diagnosis.verdict == "causes-found"
    parameters = {cause.name: cause.parameters for cause in diagnosis.causes}
    assert set(parameters) == {LINE, "position-sensor-lag"}
    assert parameters["position-sensor-lag"]["tau_s"].value == pytest.approx(lag_s, rel=0.05)
