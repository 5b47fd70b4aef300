"""The queries and bodies of requests, beside the commands of a board (commands.py).

The keys of the jobs are those that starts.py reads of a page's request.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, dataclass_transform

from pydantic import Field

from gateway.views.board_feed import RETAINED_EVENTS
from gateway.views.hmi.api.recent import LONGEST_S
from protocol.checked import Flag, Keys, Number, Whole, key

MAX_RATE_HZ = 1000.0
CampaignName = Annotated[str, key("name of the campaign; empty: the newest")]
ModelName = Annotated[str, key("name of the model, of GET /rigs/{rig}/models")]
Kind = Literal[
    "record", "campaign", "identify", "validate", "diagnose", "compare", "bode", "design", "forecast", "hand-over"
]


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Form(Keys):
    """The base of all of them: each class below it is a frozen dataclass, and its fields are the keys."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


class StatesQuery(Form):
    """The query of recent samples."""

    last_s: Annotated[Number, Field(ge=0.0, le=LONGEST_S, description="how far back, s")] = 10.0
    format: Annotated[Literal["json", "csv"], key("of the answer")] = "json"


class EventsQuery(Form):
    """The query of recent events."""

    last: Annotated[Whole, key("how many at most", 1, RETAINED_EVENTS)] = 50


class CaptureQuery(Form):
    """The query of the newest capture."""

    from_tick: Annotated[
        Whole, key("tick of the command's answer, which leaves out earlier captures; 0: any capture", 0, 2**63 - 1)
    ] = 0
    format: Annotated[Literal["json", "csv"], key("of the answer")] = "json"


class ResultQuery(Form):
    """The query of a result."""

    campaign: CampaignName = ""


class StartCampaign(Form):
    """A campaign to start; it moves the ball."""

    quick: Annotated[Flag, key("the short campaign, 35 s instead of 2 min")] = False
    investigate: Annotated[Flag, key("campaign and diagnosis in turns, until the cause is certain")] = False
    resume: Annotated[str, key("name of an interrupted campaign to continue; the other keys are then ignored")] = ""


class Identify(Form):
    """An identification to start."""

    campaign: CampaignName = ""


class StartRecording(Form):
    """A recording to start: a file of its own beside the log, which is always written."""

    title: Annotated[str, key("becomes part of the file's name")] = ""


class StreamQuery(Form):
    """The query of a stream."""

    rate_hz: Annotated[
        Number, Field(ge=0.1, le=MAX_RATE_HZ, description="samples a second; at most as many as the board sends")
    ] = 50.0
    format: Annotated[Literal["json", "csv"], key("of the messages")] = "json"


class Validate(Form):
    """Compare the identified model of a campaign with its judge recordings."""

    job: Literal["validate"]
    campaign: CampaignName = ""


class Diagnose(Form):
    """Find the causes of the model's errors."""

    job: Literal["diagnose"]
    campaign: CampaignName = ""
    quick: Annotated[Flag, key("fewer draws")] = False
    live: Annotated[Flag, key("diagnose the last 2 min of flight; campaign and quick are then ignored")] = False


class Compare(Form):
    """Compare two models on the flights of a campaign that judge models."""

    job: Literal["compare"]
    campaign: CampaignName = ""
    first: ModelName
    second: ModelName


class Bode(Form):
    """Compare the frequency responses of a campaign with its model."""

    job: Literal["bode"]
    campaign: CampaignName = ""


class Design(Form):
    """Design gains for a model; the result design has the command that loads them."""

    job: Literal["design"]
    campaign: CampaignName = ""
    model: ModelName
    law: Annotated[Literal["lqi", "pid"], key("control law")] = "lqi"
    x_m: Annotated[Number, key("position at the operating point, m")]
    settling_s: Annotated[Annotated[Number, Field(gt=0.0)] | None, key("settling time, s; null: the usual one")] = None


class Forecast(Form):
    """Predict a recorded flight under the newest design of a campaign."""

    job: Literal["forecast"]
    campaign: Annotated[str, key("name of the campaign")]


class HandOver(Form):
    """Give a model to the running twin; what it replaces is kept."""

    job: Literal["hand-over"]
    model: ModelName


class StopJob(Form):
    """A job to interrupt; a campaign parks the ball."""

    job: Annotated[Kind, key("which")]


JOBS: dict[str, type] = {  # of the key "job"
    "validate": Validate, "diagnose": Diagnose, "compare": Compare, "bode": Bode, "design": Design,
    "forecast": Forecast, "hand-over": HandOver,
}  # fmt: skip
