"""Sentences on a design: what its model leaves open, what its causes change, and margins that are thin."""

from __future__ import annotations

import dataclasses

from twin.control_design.gains import Law, OperatingPoint, Weights, design_gains, in_order_of
from twin.control_design.loop import Gains, backward, radius
from twin.control_design.margins import Margins
from twin.control_design.robust import plant_at
from twin.model.assumed import assumption_warning
from twin.model.causes.catalogue import with_trait
from twin.model.equilibrium import equilibrium
from twin.model.extension import sentences
from twin.model.parameters import Model
from twin.model.simulate import left_out

# Usual least margins: phase 30 to 60 deg, gain 2 to 5.
# K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed., sec. 10.3.
THIN_PHASE_DEG, THIN_GAIN = 30.0, 2.0


def changes(
    model: Model, point: OperatingPoint, weights: Weights, K: Gains, sample_time_s: float, law: Law
) -> tuple[str, ...]:
    """Return the sentences on the causes of the model, and on the design without them."""
    if not model.causes:
        return ()
    plain = dataclasses.replace(model, causes=())
    i, u = equilibrium(plain, point.x_m)
    # Designed anew, because the question is what a model without the causes would have given.
    without = design_gains(
        plain, OperatingPoint(i_a=i, x_m=point.x_m, u_v=u), weights, sample_time_s=sample_time_s, law=law
    )
    plant = plant_at(model, point.x_m, sample_time_s)
    messages = sentences(model) + left_out(model)
    messages.append(f"without them: i_c = {i:.4f} A and u_c = {u:.4f} V would hold the ball there")
    messages.append(
        "gains without them: "
        + ", ".join(f"{gain:.6g}" for gain in in_order_of(law, without))
        + f"; on this model their largest |pole| is {radius(plant, backward(without, sample_time_s)):.4f},"
        + f" that of the design {radius(plant, backward(K, sample_time_s)):.4f}"
    )
    if any(cause.name in with_trait("sticks") for cause in model.causes):
        messages.append("dry friction is left out of the linear design: at rest it holds the ball, in motion it brakes")
    return tuple(messages)


def unsure(model: Model) -> tuple[str, ...]:
    """Return the sentences on what the model does not know for sure."""
    messages = [assumption_warning(model.plant)] if model.plant.assumed else []
    messages += [
        f"{name} = {p.value:.4g} {p.unit} is {p.verdict}: {p.method}"
        for name, p in model.parameters.items()
        if p.verdict in ("weak", "not-identifiable")
    ]
    delays = [
        int(usage.get("input_delay", 0))
        for usage in model.provenance.get("recordings", [])
        if isinstance(usage, dict) and usage.get("input_delay")
    ]
    if delays:
        messages.append(
            f"in {len(delays)} recordings u_c acted {max(delays)} sample(s) late; the design has no delay: "
            "compare it with the delay margin"
        )
    return tuple(messages)


def thin(m: Margins) -> list[str]:
    """Return the sentences on margins of a stable loop below the usual ones."""
    messages = []
    if m.phase_deg < THIN_PHASE_DEG:
        messages.append(f"small phase margin: {m.phase_deg:.0f} deg, usual are {THIN_PHASE_DEG:g} deg or more")
    if m.gain_high < THIN_GAIN or m.gain_low > 1.0 / THIN_GAIN:
        messages.append(
            f"small gain margin: stable for {m.gain_low:.2f} to {m.gain_high:.2f} times the gain, "
            f"usual are {1.0 / THIN_GAIN:g} to {THIN_GAIN:g} or more"
        )
    return messages
