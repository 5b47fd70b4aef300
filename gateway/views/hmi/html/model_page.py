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
from gateway.views.hmi.texts import text_of, texts_of
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import Cause, Diagnosis
from protocol.errors import DataError
from protocol.experiments import EXPERIMENT_OF_NAME
from protocol.files import parse_json

KINDS = ("campaign", "identify", "diagnose", "hand-over")
May = Callable[[str], bool]


def steps(chosen: CampaignFolder | None, may: May) -> Markup:
    """Return the buttons in the order of the work, with their messages."""
    name = chosen.name if chosen is not None and chosen.toml is not None else ""
    measure = _row(
        controls.job(text_of("work.run_quick"), "campaign", "start", quick=True),
        controls.job(text_of("work.run_all"), "campaign", "start", quick=False),
        controls.job(text_of("work.investigate"), "campaign", "start", investigate=True),
    )
    identify = _row(controls.job(text_of("work.identify_button"), "identify", "start", campaign=name))
    assumed = text_of("work.plant_assumed") if chosen is not None and chosen.plant_assumed else ""
    of_campaign = (
        controls.job(text_of("work.diagnose_quick"), "diagnose", "start", campaign=name, quick=True),
        controls.job(text_of("work.diagnose_button"), "diagnose", "start", campaign=name, quick=False),
    )
    live = controls.job(text_of("work.diagnose_live", minutes=f"{LIVE_MIN:g}"), "diagnose", "start", live=True)
    diagnose = _row(*(of_campaign if name else ()), live)
    if chosen is None:
        of = text_of("work.no_campaign")
    else:
        of = text_of("work.uses", date=chosen.made) if name else text_of("work.uses_empty", date=chosen.made)
    if not may("campaign"):
        return _card(text_of("work.title"), _hint(text_of("work.engineers_only")))
    return _card(
        text_of("work.title"),
        _step(text_of("work.measure"), text_of("work.measure_hint"), measure, "campaign"),
        _step(text_of("work.identify"), of, identify if name else Markup(), "identify", warning=assumed),
        _step(text_of("work.diagnose"), of, diagnose, "diagnose"),
        _step(text_of("work.hand_over"), text_of("work.hand_over_hint"), Markup(), "hand-over"),
    )


def _twin_now(running: pb.TwinModel | None) -> Markup:
    """Return the card of the model on which the twin runs."""
    message = tag("div", data_live="wrong", class_="wrong", role="status")
    title = text_of("twin_card.title")
    if running is None:
        return _card(title, _hint(text_of("twin_card.absent")), message)
    try:
        content = summary(parse_json(running.model_json, where="the twin's model"))
    except (DataError, AttributeError):
        content = ""
    names = {"model": running.name, "sha256": running.sha256[:12]}
    if running.who:
        origin = text_of("twin_card.handed_over", **names, who=running.who)
    else:
        origin = text_of("twin_card.started_with", **names)
    return _card(title, message, tag("div", origin, class_="strong"), _hint(content))


def diagnosis_card(
    chosen: CampaignFolder | None, diagnosis: Diagnosis | None, problem: str, report: str, may: May
) -> Markup:
    """Return the card with the result of the diagnosis of a campaign."""
    if chosen is None:
        return _card(text_of("result.title"), _hint(text_of("result.no_campaign")))
    title = text_of("result.title_of", date=chosen.made)
    if diagnosis is None:
        return _card(title, _hint(problem or text_of("result.not_diagnosed")))
    causes = [_cause(chosen, cause, may, sure=bool(diagnosis.causes)) for cause in diagnosis.suspects]
    warnings = [tag("li", text) for text in diagnosis.warnings]
    verdict = texts_of("verdict").get(diagnosis.verdict, diagnosis.verdict)
    assumed = diagnosis.plant_assumed or chosen.plant_assumed
    return _card(
        title,
        tag("div", verdict, class_="verdict", data_verdict=diagnosis.verdict),
        tag("p", diagnosis.sentence, class_="sentence"),
        _warning(text_of("result.plant_assumed") if assumed else ""),
        errors_figure(diagnosis.ahead) if diagnosis.ahead else Markup(),
        *causes,
        Markup() if diagnosis.calibrated else _hint(text_of("result.quick")),
        tag("ul", *warnings, class_="hint") if warnings else Markup(),
        tag("a", text_of("result.report"), href=f"/report/{report}") if report else Markup(),
    )


def models_card(models: list[ModelFile], may: May) -> Markup:
    """Return the card of the models, each with its origin."""
    rows = [_model(model, may) for model in models]
    if not rows:
        return _card(text_of("models.title"), _hint(text_of("models.none")))
    assumed = any(plant_assumed(model.content) for model in models)
    note = text_of("models.plant_assumed") if assumed else ""
    return _card(text_of("models.title"), *rows, _warning(note), _hint(text_of("models.units")))


def campaigns_card(board: str, campaigns: list[CampaignFolder], chosen: CampaignFolder | None, may: May) -> Markup:
    """Return the card of the rig's campaigns; the chosen one is marked."""
    if not campaigns:
        return _card(text_of("campaigns.title"), _hint(text_of("campaigns.none")))
    rows = [_campaign(board, campaign, may, looked_at=campaign is chosen) for campaign in campaigns]
    return _card(text_of("campaigns.title"), *rows)


def _step(title: str, hint: str, buttons: Markup, kind: str, *, warning: str = "") -> Markup:
    end = controls.job(text_of("work.interrupt") if kind == "campaign" else text_of("work.cancel"), kind, "stop")
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
    lines = [tag("div", text_of("result.cause", name=cause.name, sentence=cause.sentence), class_="strong")]
    confidence = f"{cause.confidence:.2f}"
    if sure:
        lines.append(_hint(text_of("result.is_cause", confidence=confidence)))
    else:
        lines.append(_hint(text_of("result.is_candidate", confidence=confidence)))
    if cause.confounders:
        lines.append(_warning(text_of("result.equals", causes=", ".join(cause.confounders))))
    if cause.experiments and may("campaign"):
        lines.append(_row(*(_experiment(chosen, name) for name in list(cause.experiments)[:3])))
    lines += [_hint(text_of("result.outside", measurement=text)) for text in cause.outside]
    if cause.confirm:
        lines.append(_hint(text_of("result.confirm", action=cause.confirm)))
    if cause.cure:
        lines.append(_hint(text_of("result.remedy", action=cause.cure)))
    return tag("div", *lines, class_="cause")


def _experiment(chosen: CampaignFolder, name: str) -> Markup:
    person = EXPERIMENT_OF_NAME[name].person
    if person:
        text = text_of("result.next_prepared", preparation=person, experiment=name)
    else:
        text = text_of("result.next", experiment=name)
    return controls.job(text, "campaign", "start", campaign=chosen.name, experiment=name, prepared=bool(person))


def _model(model: ModelFile, may: May) -> Markup:
    if model.in_use:
        act = tag("span", text_of("models.in_use"), class_="in-use")
    elif may("use_model"):
        text = text_of("models.return") if model.was_replaced else text_of("models.hand_over")
        act = controls.job(text, "hand-over", "start", model=model.name)
    else:
        act = Markup()
    words = tag("div", tag("div", model.kind, class_="strong"), _hint(model.summary), class_="file-name")
    return tag("div", words, tag("span", model.made, class_="at"), act, class_="file")


def _campaign(board: str, campaign: CampaignFolder, may: May, *, looked_at: bool) -> Markup:
    stages = (
        (text_of("campaigns.identified"), campaign.model is not None),
        (text_of("campaigns.diagnosed"), campaign.diagnosis is not None),
        (text_of("campaigns.not_finished"), campaign.interrupted),
        (text_of("campaigns.plant_assumed"), campaign.plant_assumed),
    )
    marks = [word for word, holds in stages if holds]
    acts = [_hint(text_of("campaigns.act", at=act.at, who=act.who, what=act.what)) for act in campaign.acts]
    title = tag("a", text_of("campaigns.campaign", date=campaign.made), href=f"/model/{board}?campaign={campaign.name}",
                aria_current="true" if looked_at else None)  # fmt: skip
    if campaign.recordings == 1:
        recordings = text_of("campaigns.one_recording")
    else:
        recordings = text_of("campaigns.recordings", count=campaign.recordings)
    details = ", ".join([recordings, *marks])
    resume = controls.job(text_of("campaigns.continue"), "campaign", "start", campaign=campaign.name, resume=True)
    act = tag("span", resume, data_idle="campaign") if campaign.interrupted and may("campaign") else Markup()
    words = tag("div", title, *acts, class_="file-name")
    return tag("div", words, tag("span", details, class_="at"), act, class_="file")


def _card(title: str, *content: Markup) -> Markup:
    return tag("section", tag("h2", title, class_="card-title"), *content, class_="card")


def _hint(text: str) -> Markup:
    return tag("div", text, class_="hint")


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
