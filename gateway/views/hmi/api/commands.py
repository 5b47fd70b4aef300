"""The bodies of POST /rigs/{rig}/commands, and the command of the bus that each gives.  Pure.

The names are those of `board51 send`, and `gateway.client.commands` builds the command for both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field

from gateway.board.limits import MAX_SHELVE_S
from gateway.client import commands
from gateway.views.hmi.api.forms import Form
from gateway.views.hmi.api.shapes import Mode
from protocol.bus import board51_pb2 as pb
from protocol.checked import Flag, Number, Whole, key
from protocol.errors import DataError
from protocol.plant import GRAVITY_M_S2, Plant

_LARGEST = 2**32 - 1  # of a whole number on the bus


class SetMode(Form):
    """Enter a mode; clears a fault whose cause is gone."""

    command: Literal["mode"]
    mode: Annotated[Mode, key("source of the input")]


class SetReference(Form):
    """Set the position to hold."""

    command: Literal["reference"]
    x_ref_m: Annotated[Number, key("position, m, up from the sensor")]


class SetGains(Form):
    """Set law, gains and operating point, all at one tick (eq. 16-19)."""

    command: Literal["gains"]
    law: Annotated[Literal["lqi", "pid"], key("control law")] = "lqi"
    gains: Annotated[
        list[Number],
        Field(min_length=4, max_length=4, description="four, SI: k_i k_x k_v k_int of LQI, k_p k_int k_d 0 of PID"),
    ]
    i_0_a: Annotated[Number, key("current at the operating point, A")]
    x_0_m: Annotated[Number, key("position at the operating point, m")]
    u_0_v: Annotated[Number, key("input at the operating point, V")]


class Excite(Form):
    """Play a signal on u_c (open loop) or on the reference (closed loop); the shape none ends it."""

    command: Literal["excite"]
    shape: Annotated[
        Literal["none", "step", "rectangle", "sawtooth", "prbs", "multisine", "chirp"], key("of the signal")
    ]
    on_reference: Annotated[Flag, key("true: the reference, m; false: the input u_c, V")] = False
    amplitude: Annotated[Number, key("V or m")] = 0.0
    offset: Annotated[Number | None, key("V or m, absolute")] = None
    period_s: Annotated[Number, key("period, s")] = 0.0
    period_end_s: Annotated[Number, key("last period of a chirp, s")] = 0.0
    duration_s: Annotated[Number | None, key("length, s; needed for every shape except none, or endless")] = None
    endless: Annotated[Flag, key("without an end, if the gateway allows it")] = False
    seed: Annotated[Whole, key("of prbs and multisine", 0, _LARGEST)] = 1


class Capture(Form):
    """Record i_c at 25 kHz around a step of u_c, into the log."""

    command: Literal["capture"]
    u_from_v: Annotated[Number, key("input before the step, V")]
    u_to_v: Annotated[Number, key("input after the step, V")]
    duration_s: Annotated[Number, key("length, s")] = 0.04
    pre_s: Annotated[Number, key("time before the step, s")] = 0.004


class SetStream(Form):
    """Make the board send every n-th tick."""

    command: Literal["stream"]
    divider: Annotated[Whole, key("n; 0: none", 0, _LARGEST)]


class SetHostLoss(Form):
    """Set what the board does without its host."""

    command: Literal["host-loss"]
    policy: Annotated[Literal["keep", "coil-off", "hold"], key("action")]
    timeout_s: Annotated[Number, key("time without the host, s")] = 1.0


class Mark(Form):
    """Write a remark into every log."""

    command: Literal["mark"]
    text: Annotated[str, key("the remark")]


class Acknowledge(Form):
    """Acknowledge an alarm, in every view and in the log."""

    command: Literal["acknowledge"]
    alarm: Annotated[str, key("its name, such as divergence-x")]
    comment: Annotated[str, key("the reason")] = ""


class Shelve(Form):
    """Keep an alarm quiet for a time, in every view, even if it goes and comes back."""

    command: Literal["shelve"]
    alarm: Annotated[str, key("its name, such as divergence-x")]
    shelve_s: Annotated[Annotated[Number, Field(gt=0.0, le=MAX_SHELVE_S)], key("duration, s; at most 24 h")]
    comment: Annotated[str, key("the reason")] = ""


class Unshelve(Form):
    """Bring a shelved alarm back before its time; it is acknowledged then, as one that is not shelved."""

    command: Literal["unshelve"]
    alarm: Annotated[str, key("its name, such as divergence-x")]
    comment: Annotated[str, key("the reason")] = ""


class SetPlant(Form):
    """State the plant of the rig for its card; values that are unusual have to be confirmed."""

    command: Literal["plant"]
    name: Annotated[str, key("of the rig")]
    mass_kg: Annotated[Number, key("mass of the ball, kg")]
    travel_m: Annotated[Number, key("highest position of the ball, m")]
    x_max_m: Annotated[Number | None, key("x_max of eq. (3), m; without it the travel")] = None
    gravity_m_s2: Annotated[Number, key("acceleration of gravity, m/s^2")] = GRAVITY_M_S2
    ball_diameter_m: Annotated[Number | None, key("of a ball of steel, m")] = None
    confirmed: Annotated[Flag, key("unusual values are right")] = False


class Stop(Form):
    """Switch the coil off at once, as POST /rigs/{rig}/stop."""

    command: Literal["stop"]


class Ping(Form):
    """Ask the board for an answer."""

    command: Literal["ping"]


def _gains(*, law: str, gains: list[float], i_0_a: float, x_0_m: float, u_0_v: float) -> pb.Command:
    return commands.set_gains(gains, commands.OperatingPoint(i_c_a=i_0_a, x_m=x_0_m, u_c_v=u_0_v), law=law)


def _excite(*, shape: str, duration_s: float | None, endless: bool, **how: Any) -> pb.Command:
    if shape != "none" and duration_s is None and not endless:
        raise DataError(f"The {shape} has no duration_s", remedy="Give duration_s, or endless = true")
    return commands.excite(shape, duration_s=math.inf if endless else duration_s, **how)


def _shelve(*, alarm: str, shelve_s: float, comment: str) -> pb.Command:
    return commands.shelve(alarm, shelve_s, comment=comment)


def _plant(*, travel_m: float, x_max_m: float | None, confirmed: bool, **stated: Any) -> pb.Command:
    plant = Plant(travel_m=travel_m, x_max_m=travel_m if x_max_m is None else x_max_m, **stated)
    return commands.set_plant(plant, confirmed=confirmed)


KINDS: dict[str, tuple[type, Callable[..., pb.Command]]] = {  # of the key "command"; the function takes all other keys
    "mode": (SetMode, commands.set_mode),
    "reference": (SetReference, commands.set_reference),
    "gains": (SetGains, _gains),
    "excite": (Excite, _excite),
    "capture": (Capture, commands.capture),
    "stream": (SetStream, commands.set_stream),
    "host-loss": (SetHostLoss, commands.set_host_loss),
    "mark": (Mark, commands.mark),
    "acknowledge": (Acknowledge, commands.acknowledge),
    "shelve": (Shelve, _shelve),
    "unshelve": (Unshelve, commands.acknowledge),
    "plant": (SetPlant, _plant),
    "stop": (Stop, commands.stop),
    "ping": (Ping, commands.ping),
}


def command_of(body: Form) -> pb.Command:
    """Return the command of the bus that a body gives."""
    keys = dict(vars(body))
    _, make = KINDS[keys.pop("command")]
    return make(**keys)
