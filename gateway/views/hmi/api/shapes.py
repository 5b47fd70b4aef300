"""The answers of the API: their fields are the keys of the JSON and the rows of its description.

SI units, the unit is the end of a name.  Position is up from the sensor.  What is not known is null.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_type_hints

from typing_extensions import TypedDict

from protocol.checked import key
from protocol.wire.messages import Flag

Real = float | None
_FLAGS = ", ".join(f"{flag.value} {str(flag.name).lower()}" for flag in Flag)
Mode = Literal["idle", "open-loop", "closed-loop"]


class State(TypedDict):
    """A sample of the board.  What was not measured is null."""

    t_s: Annotated[float, key("time on the board's clock since its reset, s")]
    tick: Annotated[int, key("control periods since the board's reset: the time base; rises within a session")]
    session: Annotated[int, key("a new number after each reset or reconnection: nothing is continuous across it")]
    host_time_s: Annotated[float, key("arrival at the gateway, Unix time, s")]
    i_c_a: Annotated[Real, key("coil current, A")]
    x_m: Annotated[Real, key("position of the ball, m, up from the sensor")]
    u_c_v: Annotated[Real, key("input in force from this tick to the next, V")]
    x_ref_m: Annotated[Real, key("reference in force at this tick, m")]
    mode: Annotated[Mode, key("source of the input")]
    flags: Annotated[int, key(f"bit mask: {_FLAGS}")]
    lost_before: Annotated[int, key("samples missing directly before this one; in a stream: since the one before")]


_COLUMNS: Any = {name: list[hint] for name, hint in get_type_hints(State).items()}  # type: ignore[valid-type]  # made at run time
States: Any = TypedDict("States", _COLUMNS)  # type: ignore[misc]  # as above
States.__doc__ = "Samples as columns, the oldest first: one array of equal length for each field of a sample."


class RigNow(TypedDict):
    """The state of a rig, in the list and by itself."""

    name: str
    link: Annotated[str, key("live; connecting, handshake, streaming, silent, absent; no-gateway")]
    age_s: Annotated[Real, key("age of the newest sample, s")]
    mode: Mode | None
    coil: Annotated[Literal["on", "off", "in-doubt"] | None, key("whether the coil is driven")]
    x_ref_m: Annotated[Real, key("reference, m")]


class RigEntry(RigNow):
    """A rig in the list of all rigs."""

    x_m: Annotated[Real, key("position of the ball, m")]
    alarms: Annotated[int, key("active alarms")]
    fault: Annotated[bool, key("whether one of them is a fault")]


class Rigs(TypedDict):
    """All rigs of the site of which a message has come."""

    site: str
    rigs: list[RigEntry]


class AlarmEntry(TypedDict):
    """An alarm that is active, not acknowledged or shelved."""

    name: Annotated[str, key("kebab-case, stable; for the command acknowledge")]
    severity: Literal["warning", "fault"]
    text: str
    active: bool
    acknowledged: bool
    acknowledger: str
    since_s: Annotated[float, key("latest coming, Unix time, s")]
    times: Annotated[int, key("how often it came")]
    shelved_until_s: Annotated[float | None, key("Unix time, s; null: it is not shelved")]


class Alarms(TypedDict):
    """The alarms of a rig, the most urgent first."""

    alarms: list[AlarmEntry]


class EventEntry(TypedDict):
    """An event: it happened at one moment."""

    host_time_s: Annotated[float, key("Unix time, s")]
    tick: Annotated[int, key("of the board; 0 where the gateway is the source")]
    session: Annotated[int, key("of the board, as in a sample")]
    source: Annotated[str, key("board, gateway or twin")]
    severity: Annotated[str, key("info, warning or fault")]
    name: Annotated[str, key("kebab-case, stable")]
    text: str


class Events(TypedDict):
    """The newest events of a rig, the oldest first."""

    events: list[EventEntry]


class Notice(TypedDict):
    """A message of the stream of events: either of the two."""

    event: EventEntry | None
    alarm: Annotated[
        AlarmEntry | None, key("the alarm as it is now; it is over if it is neither active nor to be acknowledged")
    ]


class CaptureSamples(TypedDict):
    """The coil current around a step of the input, at 25 kHz."""

    session: Annotated[int, key("as in a sample")]
    tick: Annotated[int, key("at which it began")]
    sample_time_s: float
    u_from_v: Annotated[float, key("input before the step, V")]
    u_to_v: Annotated[float, key("input after the step, V")]
    t_s: Annotated[list[float], key("time from the step, s")]
    i_c_a: Annotated[list[float], key("coil current, A")]


class Divergence(TypedDict):
    """The rig minus its twin, as in the newest message of the twin."""

    error_x_m: Annotated[Real, key("measured minus modelled position, m")]
    error_x_sigma: Annotated[Real, key("the same over its standard deviation by the model's noise")]
    error_i_c_a: Annotated[Real, key("measured minus modelled current, A")]
    nis_mean: Annotated[Real, key("mean normalised innovation squared: 2 if noise alone causes it")]
    nis_on: Annotated[Real, key("value that nis_mean must exceed for the alarm")]


class TwinModel(TypedDict):
    """The model on which the twin runs."""

    name: str
    sha256: str
    who: Annotated[str, key("who handed it over; empty: the twin was started with it")]


class Limits(TypedDict):
    """The limits of a board, and the gains that it has."""

    x_ref_min_m: Annotated[float, key("lowest reference, m")]
    x_ref_max_m: Annotated[float, key("highest reference, m")]
    x_ref_step_max_m: Annotated[float, key("largest jump of the reference at once, m")]
    u_max_v: Annotated[float, key("largest input, V")]
    sample_time_s: Annotated[float, key("control period T_s, s")]
    law: Literal["lqi", "pid"]
    gains: Annotated[list[float], key("SI, in the order of the law")]
    i_0_a: Annotated[float, key("current at the operating point, A")]
    x_0_m: Annotated[float, key("position at the operating point, m")]
    u_0_v: Annotated[float, key("input at the operating point, V")]
    firmware: str


class Rig(RigNow):
    """The status of one rig."""

    reason: Annotated[str, key("why no samples arrive; empty where live")]
    flags: Annotated[list[str], key("in words, such as position-clipped")]
    alarms: Annotated[list[AlarmEntry], key("the most urgent first")]
    twin: Annotated[str, key("none, stale, in-step, settling or out-of-step")]
    divergence: Divergence | None
    model: TwinModel | None
    limits: Limits | None
    log_state: Annotated[str, key("writing, off, disk-full, or failed with the reason; empty: not known")]


class Reply(TypedDict):
    """The outcome of a command or of another act."""

    executed: Annotated[bool, key("whether the board, or who is responsible, accepted it")]
    code: Annotated[str, key("reason of a refusal, kebab-case, stable; empty where executed")]
    message: Annotated[str, key("what happened; may be empty where executed")]
    remedy: Annotated[str, key("what to do about a refusal; empty where executed")]
    refused_by: Annotated[str, key("gateway, board, link, twin, view or hmi; empty where executed")]
    tick: Annotated[int, key("tick from which it is in force; 0 where that has no meaning")]


class Problem(TypedDict):
    """The answer of a request that failed."""

    code: Annotated[str, key("kebab-case, stable")]
    message: Annotated[str, key("what is wrong")]
    remedy: Annotated[str, key("what to do")]


class Work(TypedDict):
    """A job that runs, or the latest of its kind that ran."""

    kind: Annotated[str, key("record, campaign, identify, validate, design ...")]
    title: str
    who: str
    running: bool
    failed: Annotated[bool, key("whether it ended without an answer")]
    progress: Annotated[Real, key("share of its steps that are done; null: it counts none")]
    standing: Annotated[str, key("in words: running for 12 s, done, failed and why")]
    lines: Annotated[list[str], key("the newest lines that it printed")]


class Jobs(TypedDict):
    """The latest job of each kind of a rig."""

    jobs: list[Work]


class Campaign(TypedDict):
    """A campaign of a rig."""

    name: str
    recordings: int
    interrupted: Annotated[bool, key("whether experiments are left, so that it can be resumed")]
    left: Annotated[list[str], key("experiments that are left")]
    has_model: Annotated[bool, key("whether it was identified")]
    has_diagnosis: bool


class Campaigns(TypedDict):
    """The campaigns of a rig, the newest first, and the progress of the latest."""

    work: Work | None
    campaigns: list[Campaign]


class ModelEntry(TypedDict):
    """A model of a rig."""

    name: str
    kind: str
    made: Annotated[str, key("time of the last change, of this server's clock")]
    summary: Annotated[str, key("parameters and causes in one line")]
    in_use: Annotated[bool, key("whether the twin runs on it")]


class Models(TypedDict):
    """The models of a rig, those of the newest campaign first, and the progress of the latest identification."""

    work: Work | None
    models: list[ModelEntry]


class LogEntry(TypedDict):
    """A log or recording: an MCAP file."""

    name: str
    bytes: int
    changed_s: Annotated[float, key("time of the last change, Unix time, s")]


class Logs(TypedDict):
    """The logs and recordings, the newest first."""

    logs: list[LogEntry]
