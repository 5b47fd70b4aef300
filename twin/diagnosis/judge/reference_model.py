"""A reference model: the user's model file, evaluated without changes.

Rule 1: it must be a model of the campaign's plant.  The values of [plant] are not estimated, so another mass is another
        rig.
Rule 2: its parameters are the baseline of the gain; the search itself starts from the paper's model, fitted again.
"""

from __future__ import annotations

from dataclasses import replace

from protocol.campaign import Plant
from protocol.errors import DataError
from twin.diagnosis.judge.prediction_gain import Gain
from twin.inference.theta import NOISES, PARAMETERS, Theta
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model
from twin.settings import diagnosis as settings

_KNOWN = ("mass_kg", "travel_m", "x_max_m", "gravity_m_s2")


def check_plant(model: Model, plant: Plant) -> None:
    """Check that the model is one of this plant.

    Raises:
        DataError: names the first field that differs, with both values.
    """
    for name in _KNOWN:
        # Refused, not converted: K_c and b hold for their mass and x_max alone (6).
        value, expected = float(getattr(model.plant, name)), float(getattr(plant, name))
        if abs(value - expected) > settings.SAME_PLANT * abs(expected):
            raise DataError(
                f"--model is of another plant: its {name} is {value:g}, [plant] of the campaign has {expected:g}",
                remedy="Give a model that was identified with this [plant], or correct [plant]",
            )


def theta_of(model: Model, fitted: Theta) -> Theta:
    """The model's numbers, causes and noise; the places of the stops are those of the data."""
    numbers = [(name, getattr(model, name)) for name in PARAMETERS]
    numbers += [(name, getattr(model.noise, name)) for name in NOISES]
    causes = tuple(
        (f"{cause.name}.{name}", parameter.value)
        for cause in model.causes
        for name, parameter in cause.parameters.items()
        if BY_NAME[cause.name].detector != "gaps"
    )
    return replace(fitted.all_of(numbers), causes=causes)


def off_sentence(model: Model, fitted: Theta, gain: Gain | None, refitted: Gain | None) -> str:
    """Return a sentence on parameters that differ from the fitted ones if that costs accuracy; empty otherwise.

    Args:
        model: the reference model.
        fitted: the paper's model at its best.
        gain: of the final model over the reference model.
        refitted: of the final model over `fitted`.
    """
    if gain is None or refitted is None or gain.baseline_rmse_m < settings.REFERENCE_WORSE * refitted.baseline_rmse_m:
        return ""
    # Without b, which may be near 0, where a relative change says nothing.
    moves = {name: fitted.value(name) / max(getattr(model, name), 1e-300) - 1.0 for name in PARAMETERS if name != "b"}
    listed = ", ".join(
        f"{name} {100.0 * change:+.1f} %" for name, change in moves.items() if abs(change) > settings.REFERENCE_OFF
    )
    return (
        f"the parameters of the reference model are wrong: its error of x {gain.horizon_s * 1e3:.0f} ms ahead is "
        f"{gain.baseline_rmse_m * 1e6:.3g} µm, that of the paper's model, fitted anew, "
        f"{refitted.baseline_rmse_m * 1e6:.3g} µm" + (f" ({listed})" if listed else "")
    )
