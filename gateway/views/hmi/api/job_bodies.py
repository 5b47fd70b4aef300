"""The bodies of POST /rigs/{rig}/jobs: work on campaigns and models, each a `board51` command that runs for a while.

Their keys are those that starts.py reads of a page's request.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from protocol.checked import Flag, Keys, Number, key

CampaignName = Annotated[str, key("name of the campaign; empty: the newest")]
ModelName = Annotated[str, key("name of the model, of GET /rigs/{rig}/models")]
Kind = Literal[
    "record", "campaign", "identify", "validate", "diagnose", "compare", "bode", "design", "forecast", "hand-over"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Validate(Keys):
    """Compare the identified model of a campaign with its judge recordings."""

    job: Literal["validate"]
    campaign: CampaignName = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnose(Keys):
    """Find the causes of the model's errors."""

    job: Literal["diagnose"]
    campaign: CampaignName = ""
    quick: Annotated[Flag, key("fewer draws")] = False
    live: Annotated[Flag, key("of the last 2 min of flight; campaign and quick count for nothing then")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Compare(Keys):
    """Compare two models on the flights of a campaign that judge models."""

    job: Literal["compare"]
    campaign: CampaignName = ""
    first: ModelName
    second: ModelName


@dataclass(frozen=True, slots=True, kw_only=True)
class Bode(Keys):
    """Compare the frequency responses of a campaign with its model."""

    job: Literal["bode"]
    campaign: CampaignName = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Design(Keys):
    """Design gains for a model; the result design has the command that loads them."""

    job: Literal["design"]
    campaign: CampaignName = ""
    model: ModelName
    law: Annotated[Literal["lqi", "pid"], key("control law")] = "lqi"
    x_m: Annotated[Number, key("position at the operating point, m")]
    settling_s: Annotated[Annotated[Number, Field(gt=0.0)] | None, key("settling time, s; null: the usual one")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast(Keys):
    """Predict a recorded flight under the newest design of a campaign."""

    job: Literal["forecast"]
    campaign: Annotated[str, key("name of the campaign")]


@dataclass(frozen=True, slots=True, kw_only=True)
class HandOver(Keys):
    """Give a model to the running twin; what it replaces is kept."""

    job: Literal["hand-over"]
    model: ModelName


@dataclass(frozen=True, slots=True, kw_only=True)
class StopJob(Keys):
    """A job to interrupt; a campaign parks the ball."""

    job: Annotated[Kind, key("which")]


Body = Annotated[
    Validate | Diagnose | Compare | Bode | Design | Forecast | HandOver,
    Field(discriminator="job"),
]
KINDS: dict[str, type] = {  # of the key "job"
    "validate": Validate, "diagnose": Diagnose, "compare": Compare, "bode": Bode, "design": Design,
    "forecast": Forecast, "hand-over": HandOver,
}  # fmt: skip
