"""The page of a rig's model: campaign, identification, diagnosis, next experiment, hand-over.

What is found is written by the server; static/model.js fetches it again when a job has ended.
"""

from __future__ import annotations

from collections.abc import Callable

from gateway.views.hmi.html import controls
from gateway.views.hmi.html.errors_figure import errors_figure
from gateway.views.hmi.html.markup import Markup, tag
from gateway.views.hmi.model.campaigns import CampaignFolder
from gateway.views.hmi.model.models import ModelFile, plant_assumed, summary
from gateway.views.hmi.model.work import LIVE_MIN
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import Cause, Diagnosis
from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME
from protocol.files import parse_json

KINDS = ("campaign", "identify", "diagnose", "hand-over")
May = Callable[[str], bool]
_ASSUMED = (
    "Nobody stated the plant of this rig. A published CE 152 is assumed (8.28 g, 5.7 mm): K_c and b hold for that plant"
    " only. To state it, write mass and travel into campaign.toml of the campaign and delete the line assumed = true."
    " Then identify and diagnose again."
)
_VERDICTS = {
    "causes-found": "causes found",
    "partly-explained": "partly explained",
    "model-adequate": "the model is right",
    "unknown-cause": "no known cause explains it",
    "unfinished": "the search did not finish",
}


def steps(chosen: CampaignFolder | None, may: May) -> Markup:
    """Return the buttons in the order of the work, with their messages."""
    name = chosen.name if chosen is not None and chosen.toml is not None else ""
    measure = _row(
        controls.job("Run quick (35 s)", "campaign", "start", quick=True),
        controls.job("Run all (2 min)", "campaign", "start", quick=False),
        controls.job("Investigate (1 to 4 min)", "campaign", "start", investigate=True),
    )
    identify = _row(controls.job("Identify", "identify", "start", campaign=name))
    assumed = _ASSUMED if chosen is not None and chosen.plant_assumed else ""
    of_campaign = (
        controls.job("Diagnose, quick", "diagnose", "start", campaign=name, quick=True),
        controls.job("Diagnose", "diagnose", "start", campaign=name, quick=False),
    )
    diagnose = _row(
        *(of_campaign if name else ()),
        controls.job(f"Diagnose the last {LIVE_MIN:g} minutes of flight", "diagnose", "start", live=True),
    )
    of = f"It uses the campaign of {chosen.made}." if chosen is not None else "There is no campaign yet: run one first."
    of += " It has no recordings." if chosen is not None and not name else ""
    if not may("campaign"):
        return _card("Work", tag("div", "Only an engineer may run campaigns, identify and diagnose.", class_="hint"))
    return _card(
        "Work",
        _step("1 Measure: a campaign", "It moves the ball; the board must be idle.", measure, "campaign"),
        _step("2 Identify: K_A, T_A, K_c, b", of, identify if name else Markup(), "identify", warning=assumed),
        _step("3 Diagnose: the errors of the model and their causes", of, diagnose, "diagnose"),
        _step("4 Hand over", "Choose one of the models; the twin uses it at once.", Markup(), "hand-over"),
    )


def _twin_now(running: pb.TwinModel | None) -> Markup:
    """Return the card of the model on which the twin runs."""
    message = tag("div", data_live="wrong", class_="wrong", role="status")
    if running is None:
        return _card("The twin", tag("div", "No twin follows this rig: start `board51 twin`.", class_="hint"), message)
    try:
        content = summary(parse_json(running.model_json, where="the twin's model"))
    except (DataError, AttributeError):
        content = ""
    since = f"handed over by {running.who}" if running.who else "the model with which it was started"
    return _card(
        "The twin",
        message,
        tag("div", f"The twin runs on {running.name} ({running.sha256[:12]}), {since}.", class_="strong"),
        tag("div", content, class_="hint"),
    )


def diagnosis_card(
    chosen: CampaignFolder | None, diagnosis: Diagnosis | None, problem: str, report: str, may: May
) -> Markup:
    """Return the card with the result of the diagnosis of a campaign."""
    if chosen is None:
        return _card("Result of the diagnosis", tag("div", "Nothing yet: run a campaign.", class_="hint"))
    title = f"Result of the diagnosis, campaign of {chosen.made}"
    if diagnosis is None:
        return _card(title, tag("div", problem or "This campaign has not been diagnosed yet.", class_="hint"))
    causes = [_cause(chosen, cause, may, sure=bool(diagnosis.causes)) for cause in diagnosis.suspects]
    quick = (
        ()
        if diagnosis.calibrated
        else (tag("div", "Quick diagnosis: its confidence is not calibrated.", class_="hint"),)
    )
    warnings = [tag("li", text) for text in diagnosis.warnings]
    assumed = "The plant is assumed: K_c and b of this answer hold for a published CE 152 only."
    return _card(
        title,
        tag(
            "div", _VERDICTS.get(diagnosis.verdict, diagnosis.verdict), class_="verdict", data_verdict=diagnosis.verdict
        ),
        tag("p", diagnosis.sentence, class_="sentence"),
        _warning(assumed if diagnosis.plant_assumed or chosen.plant_assumed else ""),
        errors_figure(diagnosis.ahead) if diagnosis.ahead else Markup(),
        *causes,
        *quick,
        tag("ul", *warnings, class_="hint") if warnings else Markup(),
        tag("a", "Full report with all plots", href=f"/report/{report}") if report else Markup(),
    )


def models_card(models: list[ModelFile], may: May) -> Markup:
    """Return the card of the models, each with its origin."""
    rows = [_model(model, may) for model in models]
    if not rows:
        return _card("Models", tag("div", "None yet: identify or diagnose a campaign.", class_="hint"))
    assumed = any(plant_assumed(model.content) for model in models)
    note = "Plant assumed: nobody stated it. The values hold for a published CE 152 only." if assumed else ""
    return _card(
        "Models",
        *rows,
        _warning(note),
        tag("div", "Numbers in SI units: A/V, s, N m\u00b2/A\u00b2, N s/m.", class_="hint"),
    )


def campaigns_card(board: str, campaigns: list[CampaignFolder], chosen: CampaignFolder | None, may: May) -> Markup:
    """Return the card of the rig's campaigns; the chosen one is marked."""
    if not campaigns:
        return _card("Campaigns", tag("div", "None yet.", class_="hint"))
    return _card(
        "Campaigns", *(_campaign(board, campaign, may, looked_at=campaign is chosen) for campaign in campaigns)
    )


def _step(title: str, hint: str, buttons: Markup, kind: str, *, warning: str = "") -> Markup:
    end = controls.job("Interrupt and park the ball" if kind == "campaign" else "Cancel", kind, "stop")
    return tag(
        "div",
        tag("h3", title),
        tag("div", tag("div", buttons, data_part=f"{kind}-buttons"), data_idle=kind),
        tag("div", _row(end), data_running=kind, hidden=True),
        tag("div", hint, _warning(warning), class_="hint", data_part=f"{kind}-of"),
        tag("div", data_live=f"{kind}-said", class_="hint", role="status"),
        tag("div", data_live=f"{kind}-lines", class_="job-lines"),
        class_="step",
    )


def _warning(text: str) -> Markup:
    return tag("div", text, class_="class-of") if text else Markup()


def _cause(chosen: CampaignFolder, cause: Cause, may: May, *, sure: bool) -> Markup:
    lines = [tag("div", f"{cause.name}: {cause.sentence}", class_="strong")]
    word = "cause" if sure else "candidate"
    lines.append(tag("div", f"{word}, confidence {cause.confidence:.2f}", class_="hint"))
    if cause.confounders:
        lines.append(
            tag(
                "div", f"These recordings cannot distinguish it from {', '.join(cause.confounders)}.", class_="class-of"
            )
        )
    if cause.experiments and may("campaign"):
        lines.append(_row(*(_experiment(chosen, name) for name in list(cause.experiments)[:3])))
    lines += [tag("div", f"It needs another instrument: {text}", class_="hint") for text in cause.outside]
    if cause.confirm:
        lines.append(tag("div", f"To confirm it at the rig: {cause.confirm}.", class_="hint"))
    if cause.cure:
        lines.append(tag("div", f"To remedy it: {cause.cure}.", class_="hint"))
    return tag("div", *lines, class_="cause")


def _experiment(chosen: CampaignFolder, name: str) -> Markup:
    person = EXPERIMENT_OF_NAME[name].person
    text = f"Next experiment: {name}" if not person else f"{person} When done: record {name}"
    return controls.job(
        text, "campaign", "start", campaign=chosen.name, experiment=name, prepared=bool(person)
    )  # fmt: skip


def _model(model: ModelFile, may: May) -> Markup:
    if model.in_use:
        act = tag("span", "\u25cf in use", class_="in-use")
    elif may("use_model"):
        text = "Return to this model" if model.was_replaced else "Hand over to the twin"
        act = controls.job(text, "hand-over", "start", model=model.name)
    else:
        act = Markup()
    words = tag(
        "div", tag("div", model.kind, class_="strong"), tag("div", model.summary, class_="hint"), class_="file-name"
    )
    return tag("div", words, tag("span", model.made, class_="at"), act, class_="file")


def _campaign(board: str, campaign: CampaignFolder, may: May, *, looked_at: bool) -> Markup:
    stages = (
        ("identified", campaign.model is not None),
        ("diagnosed", campaign.diagnosis is not None),
        ("not finished", campaign.interrupted),
        ("plant assumed", campaign.plant_assumed),
    )
    marks = [word for word, holds in stages if holds]
    acts = [tag("div", f"{act.at} {act.who} {act.what}", class_="hint") for act in campaign.acts]
    title = tag("a", f"Campaign of {campaign.made}", href=f"/model/{board}?campaign={campaign.name}",
                aria_current="true" if looked_at else None)  # fmt: skip
    details = ", ".join([f"{campaign.recordings} recordings", *marks])
    resume = controls.job("Continue", "campaign", "start", campaign=campaign.name, resume=True)
    act = tag("span", resume, data_idle="campaign") if campaign.interrupted and may("campaign") else Markup()
    words = tag("div", title, *acts, class_="file-name")
    return tag("div", words, tag("span", details, class_="at"), act, class_="file")


def _card(title: str, *content: Markup) -> Markup:
    return tag("section", tag("h2", title, class_="card-title"), *content, class_="card")


def _row(*content: Markup) -> Markup:
    return tag("div", *content, class_="row-of")


def page(running: pb.TwinModel | None, work: Markup, *results: Markup) -> Markup:
    """Return the cards; static/model.js replaces the elements with `data-part`."""
    twin, model_id = _twin_now(running), "" if running is None else running.sha256[:12]
    return tag(
        "main",
        tag("div", tag("div", twin, data_part="twin"), work, class_="work", data_model=model_id),
        tag("div", *results, class_="results", data_part="results"),
        class_="model",
    )
