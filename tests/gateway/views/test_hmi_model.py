"""The page of a rig's model: what lies in the folders, who may do what, and an alarm in numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from gateway.views.hmi.model.campaigns import (
    ACTS,
    acts_of,
    board_of,
    campaigns_of,
    choose,
    find_campaign,
    write_act,
)
from gateway.views.hmi.model.models import keep, models_of, parameter_rows, summary
from gateway.views.hmi.model.numbers import in_numbers
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import load_diagnosis
from protocol.errors import DataError
from tests.harness.gateway.hmi_peers import Page, served

CAMPAIGN = "rig-20260102-030405"
MODEL: dict[str, Any] = {
    "plant": {"name": "ce152"},
    "parameters": {"K_A": {"value": 0.297}},
    "causes": [{"name": "quadratic-drag"}],
}
ANSWER = {
    "verdict": "causes-found",
    "sentence": "One cause: the coil sits higher.",
    "causes": [
        {
            "name": "air-gap-offset", "sentence": "the coil sits 0.4 mm higher", "confidence": 0.61,
            "indistinguishable_from": ["force-exponent"],
            "at_the_rig": {"confirm": "hold the ball at six heights", "cure": "x_max + d"},
            "next_experiment": {
                "experiments": [{"name": n, "separation_z": {}} for n in ("chirp", "blocked-ball", "unheard-of")],
                "not_separable_here": [],
            },
        }
    ],
    "show": {"judged": True, "ahead": [
        {"horizon_s": h, "baseline": {"value": 1e-3, "low": 9e-4, "high": 2e-3},
         "extended": {"value": 6e-6, "low": None, "high": None}, "floor_m": 5e-6} for h in (0.002, 0.02)]},
}  # fmt: skip


def campaign(root: Path, name: str = CAMPAIGN) -> Path:
    folder = root / name
    (folder / "diagnosis").mkdir(parents=True)
    (folder / "campaign.toml").write_text("[plant]\n")
    (folder / "rest.mcap").write_bytes(b"")
    (folder / "model.json").write_text(json.dumps(MODEL))
    (folder / "diagnosis" / "diagnosis.json").write_text(json.dumps(ANSWER))
    (folder / "diagnosis" / "report.html").write_text("<p>report")
    return folder


def test_campaigns_belong_to_the_rig_that_their_folder_names(tmp_path: Path) -> None:
    campaign(tmp_path)
    campaign(tmp_path, "rig-2-20260203-040506")
    (tmp_path / "rig-20260909-000000").symlink_to(tmp_path / CAMPAIGN)
    (tmp_path / "notes").mkdir()

    (entry,) = campaigns_of(tmp_path, "rig")

    assert (entry.name, entry.made, entry.recordings) == (CAMPAIGN, "2026-01-02 03:04", 1)
    assert entry.toml == tmp_path / CAMPAIGN / "campaign.toml"
    assert board_of("rig-2-20260203-040506") == "rig-2"
    assert find_campaign(tmp_path, "rig", "") == entry
    assert find_campaign(tmp_path, "rig", f"../{tmp_path.name}/{CAMPAIGN}") is None
    assert campaigns_of(tmp_path / "absent", "rig") == []


def test_who_did_what_is_kept_in_order_and_a_damaged_line_is_left_out(tmp_path: Path) -> None:
    write_act(tmp_path / "new", who="ana", what="began a campaign")
    with (tmp_path / "new" / ACTS).open("a") as stream:
        stream.write('{"at": 3}\nnot json\n')
    write_act(tmp_path / "new", who="ben", what="identified")

    acts = acts_of(tmp_path / "new")

    assert [(act["who"], act["what"]) for act in acts] == [("ana", "began a campaign"), ("ben", "identified")]
    assert acts_of(tmp_path) == ()


def test_the_model_in_use_is_marked_and_the_one_that_it_replaces_stays_in_the_list(tmp_path: Path) -> None:
    root = tmp_path / "campaigns"
    campaign(root)
    campaigns = campaigns_of(root, "rig")
    started = pb.TwinModel(name="ce152", model_json=json.dumps({**MODEL, "causes": []}))

    before = models_of(tmp_path, "rig", campaigns, started)
    keep(tmp_path, started, "rig")
    after = models_of(tmp_path, "rig", campaigns, pb.TwinModel(model_json=json.dumps(MODEL, indent=3)))

    assert [(item.kind, item.in_use) for item in before] == [("identified model, campaign of 2026-01-02 03:04", False)]
    assert [item.in_use for item in after] == [True, False]
    assert (after[0].summary, after[1].summary) == ("K_A 0.297; with quadratic-drag", "K_A 0.297")
    assert after[1].was_replaced
    (root / CAMPAIGN / "model.json").write_text("{")
    assert len(models_of(tmp_path, "rig", campaigns, None)) == 1, "a damaged one is left out"


def test_a_campaign_that_is_left_unfinished_stands_behind_finished_ones(tmp_path: Path) -> None:
    campaign(tmp_path)
    newer = campaign(tmp_path, "rig-20260202-000000")
    investigation = campaign(tmp_path, "rig-20260303-000000")
    (tmp_path / "rig-20260404-000000").mkdir()
    (newer / "run.json").write_text('{"left": ["steps"], "quick": true}')
    (investigation / "investigation.json").write_text('{"ended": null}')

    campaigns = campaigns_of(tmp_path, "rig")

    assert [(entry.left, entry.quick, entry.interrupted) for entry in campaigns] == [
        ((), False, False), ((), False, True), (("steps",), True, True), ((), False, False),
    ]  # fmt: skip
    assert choose(campaigns, "") is campaigns[3]
    assert choose(campaigns[:3], "") is campaigns[1], "where none is finished, the newest with recordings"
    assert choose(campaigns[:1], "") is None
    assert choose(campaigns, campaigns[0].name) is campaigns[0]
    (newer / "run.json").write_text("[")
    assert not campaigns_of(tmp_path, "rig")[2].interrupted, "a damaged file is none"


def test_an_answer_is_read_and_experiments_that_no_menu_has_are_left_out(tmp_path: Path) -> None:
    path = campaign(tmp_path) / "diagnosis" / "diagnosis.json"

    diagnosis = load_diagnosis(path)

    assert diagnosis.causes == diagnosis.suspects
    assert list(diagnosis.causes[0].experiments) == ["chirp", "blocked-ball"]
    assert list(diagnosis.causes[0].confounders) == ["force-exponent"]
    assert diagnosis.ahead[0].after == (6e-6, 6e-6, 6e-6)
    for damaged in ("{}", "[]", '{"verdict": 1, "sentence": 2, "causes": [3]}'):
        path.write_text(damaged)
        with pytest.raises(DataError, match=r"diagnosis\.json"):
            load_diagnosis(path)


def divergence(signal: str, *, mean: float, rms: float, noise: float) -> pb.Divergence:
    made = pb.Divergence(sync="in-step", nis_mean=8.0, innovation_valid=True)
    figures = pb.SignalDivergence(error=mean, normalised=mean / noise, rolling_rmse=rms, rolling_mean=mean)
    getattr(made, signal).CopyFrom(figures)
    return made


def test_an_alarm_says_by_how_much_which_way_and_how_often_noise_explains_it() -> None:
    more = divergence("i_c_a", mean=0.26, rms=0.264, noise=0.022)
    lower = divergence("x_m", mean=-40e-6, rms=41e-6, noise=8e-6)
    to_and_fro = divergence("x_m", mean=1e-6, rms=120e-6, noise=6e-6)

    assert (
        in_numbers("divergence-i_c", "14:59", more)
        == "The coil has drawn 0.26 A more than the model since 14:59, 12 times as much as noise explains."
    )
    assert (
        in_numbers("divergence-x", "14:59", lower)
        == "The ball has been 40 \u00b5m lower than in the model since 14:59, 5.1 times as much as noise explains."
    )
    differ = "Measured and modelled position have differed by 120 \u00b5m rms since 9:00"
    assert in_numbers("divergence-x", "9:00", to_and_fro).startswith(differ)
    assert in_numbers("innovation", "9:00", more) == (
        "Since 9:00 the prediction of the next sample has been wrong by 2.0 times as much as noise explains."
    )


def test_where_there_is_no_number_nothing_is_said() -> None:
    lost = divergence("x_m", mean=1e-3, rms=1e-3, noise=1e-6)
    lost.sync = "out-of-step"

    assert in_numbers("divergence-x", "9:00", lost) == ""
    assert in_numbers("divergence-x", "9:00", pb.Divergence(sync="in-step")) == ""
    assert in_numbers("divergence-x", "9:00", divergence("x_m", mean=math.nan, rms=math.nan, noise=1.0)) == ""
    assert in_numbers("out-of-step", "9:00", lost) == ""


@pytest.mark.slow
def test_the_page_shows_the_answer_and_only_an_engineer_has_its_buttons(tmp_path: Path) -> None:
    campaign(tmp_path / "data" / "campaigns")
    campaign(tmp_path / "data" / "campaigns", "other-20260102-030405")
    with served(tmp_path, MODEL) as (_, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        viewer_page, able = viewer.open("/model/rig"), engineer.open("/model/rig")
        rig = viewer.open("/rig/rig")
        posts = {
            name: viewer.post("/api/rig/job", {"kind": name, "act": "start", "campaign": CAMPAIGN, "model": "x"})
            for name in ("campaign", "identify", "diagnose", "bode")
        }
        answers = {
            wrong: engineer.post("/api/rig/job", {"kind": "identify", "act": "start", "campaign": wrong}).json()
            for wrong in ("../" + CAMPAIGN, "other-20260102-030405", "none")
        }
        bode = {"kind": "bode", "act": "start", "campaign": CAMPAIGN}
        nowhere = engineer.post("/api/rig/job", {**bode, "campaign": "none"}).json()
        (tmp_path / "data" / "campaigns" / CAMPAIGN / "model.json").unlink()
        not_identified = engineer.post("/api/rig/job", bode).json()
        clamp = {"kind": "campaign", "act": "start", "campaign": CAMPAIGN, "experiment": "blocked-ball"}
        unclamped = engineer.post("/api/rig/job", clamp).json()
        (tmp_path / "data" / "campaigns" / CAMPAIGN / "run.json").write_text('{"left": []}')
        resume = {"kind": "campaign", "act": "start", "resume": True}
        finished = engineer.post("/api/rig/job", {**resume, "campaign": CAMPAIGN}).json()
        unnamed = engineer.post("/api/rig/job", resume).json()
        (tmp_path / "data" / "campaigns" / CAMPAIGN / "run.json").write_text('{"left": ["steps"]}')
        forbidden = viewer.post("/api/rig/job", {**resume, "campaign": CAMPAIGN})
        unknown = engineer.post("/api/rig/job", {"kind": "hand-over", "act": "start", "model": "../x"}).json()

    for words in ("the coil sits 0.4 mm higher", "force-exponent", "confidence 0.61", "hold the ball at six heights"):
        assert words in viewer_page, "everybody may read"
    assert "data-job" not in viewer_page
    assert "Next experiment: chirp" in able
    assert "Clamp the ball" in able, "what a person must do before"
    assert f'href="/report/1/campaigns/{CAMPAIGN}/diagnosis/report.html"' in rig
    assert "other-2026" not in rig, "a report of another rig"
    assert {name: answer.status_code for name, answer in posts.items()} == dict.fromkeys(posts, 403)
    assert {answer["reason"] for answer in answers.values()} == {"no-campaign"}
    assert (nowhere["reason"], not_identified["reason"]) == ("no-campaign", "no-model")
    assert unclamped["reason"] == "person-needed"
    assert (finished["reason"], unnamed["reason"], forbidden.status_code) == ("no-campaign", "no-campaign", 403)
    assert unknown["reason"] == "no-model"


@pytest.mark.slow
def test_without_a_campaign_the_last_flight_can_be_diagnosed_and_nothing_beside_it_asks_for_one(tmp_path: Path) -> None:
    with served(tmp_path, MODEL) as (_, port):
        engineer = Page(port)
        engineer.log_in("ana")
        page = engineer.open("/model/rig")

    step = page.partition('data-part="diagnose-buttons"')[2].partition('data-running="diagnose"')[0]
    of_campaign, live = step.split('<div class="row-of">')[1:]
    assert of_campaign.count("disabled") == 2
    assert "There is no campaign yet" in of_campaign
    assert "Diagnose the last 2 minutes of flight" in live
    assert "disabled" not in live
    assert "There is no campaign yet" not in live
    assert "The last minutes of flight need no campaign" in page


@pytest.mark.slow
def test_a_campaign_is_renamed_and_deleted_by_an_engineer_alone(tmp_path: Path) -> None:
    made = campaign(tmp_path / "data" / "campaigns")
    other_campaign = campaign(tmp_path / "data" / "campaigns", "other-20260102-030405")
    with served(tmp_path, MODEL) as (_, port):
        viewer, engineer = Page(port), Page(port)
        viewer.log_in("vic")
        engineer.log_in("ana")
        rename = {"act": "rename", "name": CAMPAIGN, "title": "  a heavy <b>ball</b> "}
        refused = viewer.post("/api/rig/campaign", rename), viewer.post("/api/rig/campaign", rename | {"act": "delete"})
        named = engineer.post("/api/rig/campaign", rename).json()
        long = engineer.post("/api/rig/campaign", rename | {"title": "x" * 61}).json()
        page_text = viewer.open("/model/rig")
        wrong = [
            engineer.post("/api/rig/campaign", {"act": "delete", "name": name}).json()["reason"]
            for name in ("", "other-20260102-030405", f"../campaigns/{CAMPAIGN}")
        ]
        stood = made.is_dir()
        deleted = engineer.post("/api/rig/campaign", {"act": "delete", "name": CAMPAIGN}).json()
        again = engineer.post("/api/rig/campaign", {"act": "delete", "name": CAMPAIGN}).json()

    assert [answer.status_code for answer in refused] == [403, 403]
    assert named["text"] == "The campaign is called a heavy <b>ball</b>."
    assert "a heavy &lt;b&gt;ball&lt;/b&gt;" in page_text
    assert (long["accepted"], long["reason"]) == (False, "bad-name")
    assert wrong == ["no-campaign"] * 3
    assert stood
    assert (deleted["accepted"], again["reason"]) == (True, "no-campaign")
    assert not made.exists()
    assert other_campaign.is_dir()


def test_parameters_have_the_digits_that_their_interval_bears() -> None:
    def entry(value: float, low: float, high: float, verdict: str = "identified") -> dict[str, object]:
        return {"value": value, "unit": "A/V", "ci95": [low, high], "verdict": verdict}

    table = {"K_A": entry(0.297011, 0.296996, 0.297025), "b": entry(0.114, 0.029, 0.199, "weak"), "T_A": 3e-4}
    first, second = parameter_rows({"parameters": table})

    assert first == ("K_A", "0.2970110 A/V", "0.2969960 to 0.2970250", "identified")
    assert second[:3] == ("b", "0.114 A/V", "0.0290 to 0.199")
    assert second[3].startswith("weak: ")
    assert parameter_rows({"parameters": {"K_A": entry(1.0, 1.0, 1.0), "b": "x"}}) == []


def test_a_model_file_of_another_shape_has_an_empty_summary_and_costs_no_page() -> None:
    assert summary({"parameters": [1], "causes": 3}) == ""


def test_a_diagnosis_that_found_nothing_better_offers_no_model(tmp_path: Path) -> None:
    root = tmp_path / "campaigns"
    campaign(root)
    folder = root / CAMPAIGN / "diagnosis"
    folder.mkdir(exist_ok=True)
    file = folder / "extended_model.json"
    campaigns = campaigns_of(root, "rig")

    def offered(provenance: dict[str, str], causes: object) -> bool:
        file.write_text(json.dumps({**MODEL, "causes": causes, "provenance": provenance}))
        return any(item.path == file for item in models_of(tmp_path, "rig", campaigns, None))

    assert not offered({"extends": "reference"}, [])
    assert offered({"extends": "reference"}, MODEL["causes"])  # a curve of what is left
    assert offered({"extends": "paper"}, [])
    assert offered({}, MODEL["causes"])
