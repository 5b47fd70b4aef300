"""The queries and bodies of requests, beside the commands of a board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from gateway.views.hmi.api.recent import LONGEST_S
from protocol.checked import Flag, Keys, Number, key

MAX_RATE_HZ = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StatesQuery(Keys):
    """The query of recent samples."""

    last_s: Annotated[Number, Field(ge=0.0, le=LONGEST_S, description="how far back, s")] = 10.0
    format: Annotated[Literal["json", "csv"], key("of the answer")] = "json"


@dataclass(frozen=True, slots=True, kw_only=True)
class StartCampaign(Keys):
    """A campaign to start; it moves the ball."""

    quick: Annotated[Flag, key("the short campaign, 35 s instead of 2 min")] = False
    investigate: Annotated[Flag, key("campaign and diagnosis in turns, until the cause is certain")] = False
    resume: Annotated[str, key("name of an interrupted campaign to continue; the others count for nothing then")] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identify(Keys):
    """An identification to start."""

    campaign: Annotated[str, key("its name; empty: the newest")] = ""


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
