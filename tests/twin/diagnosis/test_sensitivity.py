"""The benchmark that halves and doubles the settings: what it varies, and that remembering changes no answer."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocol.campaign import load
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.diagnose.remembered import COMPUTE_SETTINGS, remembered
from tests.harness.diagnose.sensitivity import AS_IT_IS, VARIED, VARIED_FULL, table, variants, varied
from twin.diagnosis.options import Options
from twin.diagnosis.pipeline import diagnose_records
from twin.diagnosis.result import Diagnosis, to_json
from twin.readers.campaign import read_campaign
from twin.settings import diagnosis as settings


def test_what_is_varied_is_a_setting_that_decides_and_nothing_is_computed_by() -> None:
    assert all(isinstance(getattr(settings, name), float) for name in (*VARIED, *VARIED_FULL))
    assert not set(COMPUTE_SETTINGS) & {*VARIED, *VARIED_FULL}


def test_a_setting_is_itself_again_after_it_was_varied() -> None:
    before = settings.MIN_GAIN
    with varied("MIN_GAIN", 2.0):
        assert settings.MIN_GAIN == 2.0 * before
    assert before == settings.MIN_GAIN


def test_the_table_shows_the_settings_that_change_an_answer() -> None:
    right = {"verdict": "model-adequate", "named": [], "right": True, "found": 0, "truths": 0, "false_names": 0}
    answers = {label: dict(right) for label, _, _ in variants(False)}
    answers["MIN_GAIN halved"] |= {"verdict": "causes-found", "named": ["coulomb-friction"], "false_names": 1}

    lines = table([{"part": "nulls", "seed": 0, "full": False, "answers": answers}], False).splitlines()

    assert [line.split("|")[1].strip() for line in lines[4:6]] == [AS_IT_IS, "MIN_GAIN halved"]
    assert "1 of 1" in lines[5]
    assert "MIN_GAIN doubled" in lines[-1]
    assert "VISIBLE" in lines[-1]


@pytest.mark.sample
def test_a_remembered_answer_is_the_one_that_would_be_computed(tmp_path: Path) -> None:
    make_campaign(tmp_path, effects={"air-gap-offset": 3e-4}, seed=7, plant="emulator", quick=True)
    campaign = load(tmp_path)
    records, judges = read_campaign(campaign), read_campaign(campaign, use="judge")

    def run_diagnosis() -> Diagnosis:
        return diagnose_records(campaign, records, judges, Options(quick=True, workers=1))

    with varied("MIN_GAIN", 2.0):
        anew = run_diagnosis()
    with remembered():
        run_diagnosis()
        with varied("MIN_GAIN", 2.0):
            again = run_diagnosis()

    def to_comparable(diagnosis: Diagnosis) -> dict[str, object]:
        return {key: value for key, value in to_json(diagnosis).items() if key != "stages_s"}

    assert to_comparable(again) == to_comparable(anew)
