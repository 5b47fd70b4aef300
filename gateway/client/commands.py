"""The commands of the bus, built from typed values.  Pure.

`board51 send` and `Rig` build their commands here.  The gateway and the board decide whether a command is allowed; here
only values that do not fit a message are errors (UsageError).
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from protocol.bus import board51_pb2 as pb
from protocol.errors import UsageError

if TYPE_CHECKING:
    from protocol.plant import Plant


class Mode(enum.StrEnum):
    """The source of the input u_c."""

    IDLE = "idle"  # none: the coil is off
    OPEN_LOOP = "open-loop"  # the excitation
    CLOSED_LOOP = "closed-loop"  # the control law


class Law(enum.StrEnum):
    """The control law of the board."""

    LQI = "lqi"  # u_c = u_0 - K [i_c - i_0, x - x_0, x', integral of (x_ref - x) dt], eq. (16)-(19)
    PID = "pid"  # u_c = u_0 + K [x_ref - x, integral of (x_ref - x) dt, -x', 0]


class Shape(enum.StrEnum):
    """The signal of an excitation."""

    NONE = "none"
    STEP = "step"
    RECTANGLE = "rectangle"
    SAWTOOTH = "sawtooth"
    PRBS = "prbs"
    MULTISINE = "multisine"
    CHIRP = "chirp"


class HostLoss(enum.StrEnum):
    """The action of the board when it receives nothing from its host."""

    KEEP = "keep"
    COIL_OFF = "coil-off"
    HOLD = "hold"


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatingPoint:
    """The operating point (13) of a control law."""

    i_c_a: float  # coil current, A
    x_m: float  # position, m, up from the sensor
    u_c_v: float  # input, V


E_ = TypeVar("E_", bound=enum.StrEnum)

_POLICIES = (HostLoss.KEEP, HostLoss.COIL_OFF, HostLoss.HOLD)  # by the number on the bus
_LARGEST = 2**32 - 1


def set_mode(mode: Mode | str) -> pb.Command:
    """Enter a mode; clears a fault."""
    return pb.Command(set_mode=pb.SetMode(mode=f"MODE_{_chosen(Mode, mode, 'mode').name}"))


def set_reference(x_ref_m: float) -> pb.Command:
    """Set the position reference, m."""
    return pb.Command(set_reference=pb.SetReference(x_ref_m=_finite(x_ref_m, "x_ref_m")))


def set_plant(plant: Plant, *, confirmed: bool = False) -> pb.Command:
    """State the plant of the rig for its card; `confirmed`: its unusual values are right."""
    from protocol.bus.plant_card import plant_message  # pydantic takes its time: a STOP shall not wait for it

    return pb.Command(set_plant=pb.SetPlant(plant=plant_message(plant), confirmed=confirmed))


def set_gains(gains: Sequence[float], operating_point: OperatingPoint, *, law: Law | str = Law.LQI) -> pb.Command:
    """Set the control law, its four gains (SI, in the order of the law) and operating point, all at one tick."""
    if len(gains) != 4:
        raise UsageError(f"gains has {len(gains)} values", remedy="Give four: k_i k_x k_v k_int, or k_p k_int k_d 0")
    return pb.Command(
        set_gains=pb.SetGains(
            law=f"LAW_{_chosen(Law, law, 'law').name}",
            gains=[_finite(gain, "gains") for gain in gains],
            i_0_a=_finite(operating_point.i_c_a, "operating_point.i_c_a"),
            x_0_m=_finite(operating_point.x_m, "operating_point.x_m"),
            u_0_v=_finite(operating_point.u_c_v, "operating_point.u_c_v"),
        )
    )


def excite(
    shape: Shape | str,
    *,
    on_reference: bool = False,
    amplitude: float = 0.0,
    offset: float | None = None,
    period_s: float = 0.0,
    period_end_s: float = 0.0,
    duration_s: float | None = None,
    seed: int = 1,
) -> pb.Command:
    """Play a signal on u_c (V, open loop) or on the reference (m, closed loop); duration `math.inf`: without end."""
    shape = _chosen(Shape, shape, "shape")
    if shape == Shape.NONE:
        if on_reference and offset is not None:
            problem = "An excitation of the reference that ends leaves it at its value: the offset has no effect"
            raise UsageError(problem, remedy="Leave it out, and move the reference with the command for it")
        duration_s = 0.0
    elif duration_s is None:
        problem = f"The {shape} has no duration"
        raise UsageError(problem, remedy="Give a duration in s, or an endless one (--duration endless)")
    elif not duration_s > 0:  # 0 is endless on the bus
        raise UsageError(f"{duration_s:g} s is not a duration", remedy="Give a positive one")
    return pb.Command(
        excite=pb.Excite(
            shape=f"SHAPE_{shape.name}",
            on_reference=on_reference,
            amplitude=_finite(amplitude, "amplitude"),
            offset=None if offset is None else _finite(offset, "offset"),
            period_s=_finite(period_s, "period_s"),
            period_end_s=_finite(period_end_s, "period_end_s"),
            seed=_whole(seed, "seed"),
            duration_s=0.0 if duration_s == math.inf else _finite(duration_s, "duration_s"),
        )
    )


def capture(*, u_from_v: float, u_to_v: float, duration_s: float = 0.04, pre_s: float = 0.004) -> pb.Command:
    """Record the coil current at 25 kHz around a step of u_c, beginning `pre_s` before the step."""
    return pb.Command(
        capture=pb.Capture(
            u_from_v=_finite(u_from_v, "u_from_v"),
            u_to_v=_finite(u_to_v, "u_to_v"),
            duration_s=_finite(duration_s, "duration_s"),
            pre_s=_finite(pre_s, "pre_s"),
        )
    )


def set_stream(divider: int) -> pb.Command:
    """Make the board send every `divider`-th tick; 0: none."""
    return pb.Command(set_stream=pb.SetStream(divider=_whole(divider, "divider")))


def set_host_loss(policy: HostLoss | str, *, timeout_s: float = 1.0) -> pb.Command:
    """Set what the board does after `timeout_s` without its host."""
    code = _POLICIES.index(_chosen(HostLoss, policy, "policy"))
    return pb.Command(set_host_loss=pb.SetHostLoss(policy=code, timeout_s=_finite(timeout_s, "timeout_s")))


def mark(text: str) -> pb.Command:
    """Add a remark at this moment to every log."""
    return pb.Command(mark=pb.Mark(text=_printable(text, "text")))


def acknowledge(alarm: str, *, comment: str = "") -> pb.Command:
    """Acknowledge an alarm."""
    return pb.Command(
        acknowledge=pb.Acknowledge(alarm=_printable(alarm, "alarm"), comment=_printable(comment, "comment"))
    )


def shelve(alarm: str, duration_s: float, *, comment: str = "") -> pb.Command:
    """Shelve an alarm for a time, s; `acknowledge` brings it back before that."""
    if not duration_s > 0.0:
        raise UsageError(f"{duration_s:g} s is not a duration of shelving", remedy="Give a positive one")
    command = acknowledge(alarm, comment=comment)
    command.acknowledge.shelve_s = _finite(duration_s, "duration_s")
    return command


def stop() -> pb.Command:
    """Switch the coil off at once; mode idle."""
    return pb.Command(stop=pb.Stop())


def ping() -> pb.Command:
    """Ask the board for an answer."""
    return pb.Command(ping=pb.Ping())


def use_model(model: Path) -> pb.TwinCommand:
    """Hand a model file to the twin.

    Raises:
        DataError: the file is missing or too large.
    """
    from protocol.files import read_small

    command = pb.TwinCommand()
    command.use_model.model_json = read_small(model, remedy="Name a model file, such as model.json")
    return command


def _chosen(kind: type[E_], value: str, name: str) -> E_:
    try:
        return kind(value)
    except ValueError:
        raise UsageError(f"{name} is {value!r}", remedy=f"Choose one of {', '.join(kind)}") from None


def _finite(value: float, name: str) -> float:
    if not math.isfinite(value):
        raise UsageError(f"{name} is {value}", remedy="Give a finite number")
    return float(value)


def _whole(value: int, name: str) -> int:
    if value != int(value) or not 0 <= value <= _LARGEST:
        raise UsageError(f"{name} is {value}", remedy=f"Give a whole number from 0 to {_LARGEST}")
    return int(value)


def _printable(text: str, name: str) -> str:
    if not text.isprintable():
        raise UsageError(f"{name} {text!r} has characters that cannot be printed", remedy="Leave them out")
    return text
