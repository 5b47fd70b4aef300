"""The page of a diagnosis from points of rest: the answer, the points, the errors of each explanation."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from twin.diagnosis.equilibria.diagnosis import Explanation, StaticDiagnosis, proposal_for
from twin.diagnosis.equilibria.points import holding_currents
from twin.diagnosis.equilibria.to_json import named, not_testable, rms, sentence_of, why_not
from twin.page.figures import EXTENDED, MODEL, inline, legend_above, styled
from twin.page.render import render


def page(diagnosis: StaticDiagnosis, title: str) -> str:
    """Return the page as self-contained HTML."""
    points, base, members = diagnosis.points, diagnosis.base, diagnosis.members
    best = members[0] if members else None
    columns = (
        points.x_m,
        points.i_c_a,
        base.residual_a,
        diagnosis.base_off_m,
        best.fit.residual_a if best else base.residual_a,
        best.left_out_a if best else diagnosis.base_left_out_a,
    )
    caption = "points of rest with the curves of (3) and of the extended model, and the errors of both"
    return render(
        "diagnosis/equilibria/page.html",
        title=title,
        answer=sentence_of(diagnosis),
        colour="fail" if diagnosis.verdict == "unknown-cause" else "pass",
        picture=inline(figure(diagnosis), caption),
        points=[
            [
                f"{1e3 * x:.3f}",
                f"{1e3 * i:.1f}",
                f"{1e3 * off:+.1f}",
                f"{100 * off / i:+.1f}",
                f"{1e3 * shift:+.2f}",
                f"{1e3 * left:+.1f}",
                f"{1e3 * predicted:+.1f}",
            ]
            for x, i, off, shift, left, predicted in zip(*columns, strict=True)
        ],
        members=[
            [
                explanation.name,
                named(explanation).partition(": ")[2],
                f"{explanation.fit.theta.K_c:.3g}",
                f"{1e3 * rms(explanation.fit.residual_a):.1f}",
                f"{explanation.pole_per_s:.1f} ± {explanation.pole_std_per_s:.1f}",
            ]
            for explanation in members
        ],
        chance=_chance(diagnosis),
        proposals=[_proposal(members[0], other) for other in members[1:]],
        rejected=[f"{explanation.name}: {why_not(diagnosis, explanation)}" for explanation in diagnosis.rejected],
        warnings=diagnosis.warnings,
        not_testable=[f"{name}: {why}" for name, why in not_testable(diagnosis)],
    )


def _chance(diagnosis: StaticDiagnosis) -> str:
    if not diagnosis.members:
        return ""
    first, tried = diagnosis.members[0], len(diagnosis.members) + len(diagnosis.rejected)
    odds = f"F = {first.F:.0f} with 1 and {first.fit.freedom} degrees of freedom: by chance {first.p:.2g}"
    return f"{odds}, and {tried} causes were tried."


def _proposal(first: Explanation, other: Explanation) -> str:
    what, z, _ = proposal_for(first, other)
    return f"{first.name} or {other.name}: {what}" + (f" (z = {z:.0f})" if z >= 1.0 else "")


@styled
def figure(diagnosis: StaticDiagnosis) -> Figure:
    """Draw the currents and their errors over x."""
    drawn = Figure(figsize=(9.6, 3.8), layout="constrained")
    left, right = drawn.subplots(1, 2)
    plant, points = diagnosis.plant, diagnosis.points
    x = np.linspace(0.0, plant.travel_m, 80)
    models = [("(3) with the best K_c", diagnosis.base, MODEL)]
    if diagnosis.members:
        models.append((f"with {diagnosis.members[0].name}", diagnosis.members[0].fit, EXTENDED))
    for label, fit, colour in models:
        left.plot(1e3 * x, holding_currents(fit.theta, plant, x), color=colour, label=label)
        right.plot(1e3 * points.x_m, 1e3 * fit.residual_a, "o", color=colour, label=label)
        right.vlines(1e3 * points.x_m, 0.0, 1e3 * fit.residual_a, color=colour, alpha=0.4)
    left.plot(1e3 * points.x_m, points.i_c_a, "ks", label="measured")
    left.set(xlabel="position x [mm]", ylabel="current that holds the ball [A]", ylim=(0.0, None))
    right.axhline(0.0, color="k", lw=0.8)
    right.set(xlabel="position x [mm]", ylabel="measured - model [mA]")
    legend_above(left)
    legend_above(right)
    return drawn
