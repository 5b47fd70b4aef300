"""The queries and bodies of requests, beside the commands of a board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from gateway.views.board_feed import RETAINED_EVENTS
from gateway.views.hmi.api.job_bodies import CampaignName
from gateway.views.hmi.api.recent import LONGEST_S
from protocol.checked import Flag, Keys, Number, Whole, key

MAX_RATE_HZ = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StatesQuery(Keys):
    """The query of recent samples."""

    last_s: Annotated[Number, Field(ge=0.0, le=LONGEST_S, description="how far back, s")] = 10.0
    format: Annotated[Literal["json", "csv"], key("of the answer")] = "json"


@dataclass(frozen=True, slots=True, kw_only=True)
class EventsQuery(Keys):
    """The query of recent events."""

    last: Annotated[Whole, key("how many at most", 1, RETAINED_EVENTS)] = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureQuery(Keys):
    """The query of the newest capture."""

    from_tick: Annotated[Whole, key("tick of the command's answer: no capture of before it; 0: any", 0, 2**63 - 1)] = 0
    format: Annotated[Literal["json", "csv"], key("of the answer")] = "json"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultQuery(Keys):
    """The query of a result."""

    campaign: CampaignName = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartCampaign(Keys):
    """A campaign to start; it moves the ball."""

    quick: Annotated[Flag, key("the short campaign, 35 s instead of 2 min")] = False
    investigate: Annotated[Flag, key("campaign and diagnosis in turns, until the cause is certain")] = False
    resume: Annotated[str, key("name of an interrupted campaign to continue; the others count for nothing then")] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identify(Keys):
    """An identification to start."""

    campaign: CampaignName = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartRecording(Keys):
    """A recording to start: a file of its own beside the log, which is always written."""

    title: Annotated[str, key("becomes part of the file's name")] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamQuery(Keys):
    """The query of a stream."""

    rate_hz: Annotated[
        Number, Field(ge=0.1, le=MAX_RATE_HZ, description="samples a second; at most those that the board sends")
    ] = 50.0
    format: Annotated[Literal["json", "csv"], key("of the messages")] = "json"
