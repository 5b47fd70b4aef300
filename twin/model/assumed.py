"""A plant that nobody stated: which numbers rest on it, in words.

The recordings show accelerations and the boards' metres.  They do not show the mass of the ball, and they show the
travel only as far as the ball touches both stops.  So K_c, b and every force scale with the mass that was assumed, and
whatever is a function of the air gap with the travel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from protocol.campaign import Plant
from twin.model.causes.cause import Cause
from twin.model.parameters import Parameter

REMEDY = (
    "State mass and travel in [plant] of campaign.toml and remove `assumed = true`; for the next recordings, state them"
    " on the model page of the rig, or with `--plant FILE`"
)
RESTING = ("K_c", "b")  # parameters of (1) and (6) that rest on mass and travel
_FREE_OF_IT = ("amplifier", "timing")


def assumption(plant: Plant) -> str:
    """Name the plant for which a number holds, as the end of a sentence; empty if somebody stated the plant."""
    if not plant.assumed:
        return ""
    return f"for an assumed ball of {plant.mass_kg * 1e3:.3g} g and travel of {plant.travel_m * 1e3:.3g} mm"


def assumption_warning(plant: Plant) -> str:
    """The warning of a command; empty if somebody stated the plant."""
    if not plant.assumed:
        return ""
    return f"K_c and b are {assumption(plant)}: nobody stated the plant of this rig. {REMEDY}"


def mark(parameters: Mapping[str, Parameter], plant: Plant, names: tuple[str, ...] = RESTING) -> dict[str, Parameter]:
    """The parameters; those with these names say in `method` for which assumed plant they hold."""
    suffix = assumption(plant)
    return {
        name: replace(parameter, method=f"{parameter.method}; {suffix}") if suffix and name in names else parameter
        for name, parameter in parameters.items()
    }


def rests_on_plant(cause: Cause) -> bool:
    """Return whether the size of a cause depends on mass or travel."""
    # Whatever the family: a cause of the amplifier that follows the gap rests on the travel, too.
    if "of-the-gap" in cause.traits:
        return True
    # The board itself measures u_c, i_c and ticks: a cause that acts only on them does not depend on the mass.
    return cause.family not in _FREE_OF_IT and "current sensor" not in cause.acts_on
