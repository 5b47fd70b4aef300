"""A custom emulated rig: a CE 152 with another ball, travel or coil, from a file.

    [plant]                          # as of a campaign, and as the plant card of the rig
    mass_kg = 20e-3
    travel_m = 12e-3
    x_max_m = 16e-3
    [emulated]                       # what identification shall find; each key is optional
    force_constant_n_m2_a2 = 5e-5    # K_c

The board has the scalings of a CE 152's position sensor, stretched to the travel, so that all its limits are the same
shares of the travel.  Its gains give the loop the poles of the CE 152's loop.  With the force (3) linearised at x_0,

    x'' = a (x - x_0) + B (u - u_0),    a = 2 g / gap,    B = (2 g / i_0) K_A / (1 + K_A k_i),

and the law (16), the characteristic polynomial is s^3 + B k_v s^2 + (B k_x - a) s - B k_int.  The lag of the amplifier
and the drag are left out: both are small beside the loop.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from gateway.emulator.firmware_model import flash
from gateway.emulator.plant.constants import CE152, PlantConstants
from protocol.campaign import PlantFile
from protocol.checked import Keys, Number, checked
from protocol.errors import ConfigError
from protocol.files import parse_toml, read_small
from protocol.wire.messages import Law

BUILD = b"emul-own"  # not that of a CE 152, whose build states its plant
_MIN_GAP_M = 1e-4  # of the coil's plane above the top stop
_HEADROOM = 1.05  # of the current that lifts the ball


@dataclass(frozen=True, kw_only=True)
class _Emulated(Keys):
    """The constants that no plant states; defaults of the CE 152."""

    force_constant_n_m2_a2: Number = CE152.force_constant_n_m2_a2
    amplifier_gain_a_v: Number = CE152.amplifier_gain_a_v
    amplifier_time_constant_s: Number = CE152.amplifier_time_constant_s
    drag_n_s_m: Number = CE152.drag_n_s_m
    restitution: Number = CE152.restitution
    input_max_v: Number = CE152.input_max_v
    current_max_a: Number = CE152.current_max_a
    position_noise_m: Number = CE152.position_noise_m
    current_noise_a: Number = CE152.current_noise_a


@dataclass(frozen=True, kw_only=True)
class _File(PlantFile, Keys):
    emulated: _Emulated = _Emulated()


def load_rig(path: Path) -> tuple[PlantConstants, flash.BoardProfile]:
    """Read the file of a rig; its constants, and the board that controls it.

    Raises:
        DataError: the file is absent or not text.
        ConfigError: a key or value is wrong, or the coil cannot lift the ball.
    """
    table = parse_toml(read_small(path, remedy="Name a file with [plant] and [emulated]"), where=str(path))
    file: _File = checked(_File, table, where=str(path))
    plant = file.plant
    above_stop_m = plant.x_max_m - plant.travel_m
    if above_stop_m < _MIN_GAP_M:
        raise ConfigError(
            f"{path}: plant.x_max_m = {plant.x_max_m:g} is no more than {_MIN_GAP_M * 1e3:g} mm above the travel",
            remedy="Give where the coil acts: the plane of a CE 152 is 2.4 mm above the top stop",
        )
    rig = PlantConstants(
        mass_kg=plant.mass_kg,
        travel_m=plant.travel_m,
        gravity_m_s2=plant.gravity_m_s2,
        coil_plane_above_stop_m=above_stop_m,
        **asdict(file.emulated),
    )
    _check_lift(rig, path)
    return rig, profile_of(rig)


def profile_of(rig: PlantConstants) -> flash.BoardProfile:
    """Return the board of a rig: the CE 152's, stretched to the travel, with gains for the same poles."""
    stretch = rig.travel_m / CE152.travel_m
    position = flash.ConverterScale(offset=stretch * flash.POSITION.offset, lsb=stretch * flash.POSITION.lsb)
    input_ = replace(flash.INPUT, lsb=flash.INPUT.lsb * rig.input_max_v / CE152.input_max_v)
    current = replace(flash.CURRENT, lsb=flash.CURRENT.lsb * rig.current_max_a / CE152.current_max_a)
    x_0_m = rig.travel_m / 2.0
    point = (rig.equilibrium_current_a(x_0_m), x_0_m, rig.equilibrium_input_v(x_0_m))
    gains = flash.gains_in_counts(Law.LQI, gains_of(rig), point, (current, position, input_))
    return replace(flash.CE152_BOARD, current=current, position=position, input=input_, gains=gains, build=BUILD)


def gains_of(rig: PlantConstants) -> tuple[float, float, float, float]:
    """Return (k_i V/A, k_x V/m, k_v V s/m, k_int V/(m s)) for the poles of the CE 152's loop at half the travel."""
    k_i, k_x, k_v, k_int = flash.K_LQI
    loop_gain = k_i * CE152.amplifier_gain_a_v  # the same, so that 1 + K_A k_i is
    (a_0, b_0), (a, b) = _linear(CE152, loop_gain), _linear(rig, loop_gain)
    return loop_gain / rig.amplifier_gain_a_v, (b_0 * k_x - a_0 + a) / b, b_0 * k_v / b, b_0 * k_int / b


def _linear(rig: PlantConstants, loop_gain: float) -> tuple[float, float]:
    """Return a in 1/s2 and B in m/(s2 V) at half the travel."""
    x_0_m = rig.travel_m / 2.0
    a = 2.0 * rig.gravity_m_s2 / rig.gap_m(x_0_m)
    per_a = 2.0 * rig.gravity_m_s2 / rig.equilibrium_current_a(x_0_m)
    return a, per_a * rig.amplifier_gain_a_v / (1.0 + loop_gain)


def _check_lift(rig: PlantConstants, path: Path) -> None:
    needed_a = _HEADROOM * rig.equilibrium_current_a(0.0)
    largest_a = min(rig.current_max_a, rig.amplifier_gain_a_v * rig.input_max_v)
    if needed_a > largest_a:
        raise ConfigError(
            f"{path}: the coil cannot lift the ball: that needs {needed_a:.3g} A, it has {largest_a:.3g} A",
            remedy="Give a lighter ball, a smaller x_max_m, or a larger emulated.force_constant_n_m2_a2",
        )


def limits_toml(profile: flash.BoardProfile, board: str) -> str:
    """Return the configuration of a gateway whose limits are those of this board; its port is given elsewhere."""
    limits, x = profile.limits, profile.position
    values = {
        "x_ref_min_m": x.to_si(limits.x_ref_min),
        "x_ref_max_m": x.to_si(limits.x_ref_max),
        "x_ref_step_m": limits.x_ref_step * x.lsb,
        "x_ref_slew_m_s": limits.x_ref_slew * x.lsb,
        "u_max_v": profile.input.to_si(limits.u_max),
    }
    lines = [f"{name} = {value:.6g}" for name, value in values.items()]
    return "\n".join(["[[board]]", f'name = "{board}"', 'port = "none"', "[board.limits]", *lines, ""])
