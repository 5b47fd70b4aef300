"""The page of a diagnosis from points of rest: the answer, the points, what each explanation says of them."""

from __future__ import annotations

import html
import io

import numpy as np
from matplotlib.figure import Figure

from twin.diagnose.equilibria.diagnosis import StaticDiagnosis, proposal_for
from twin.diagnose.equilibria.points import holding_currents
from twin.diagnose.equilibria.to_json import named, not_testable, rms, sentence_of, why_not
from twin.page import CSS, bullets, image, paragraph, table

_DPI = 110


def page(found: StaticDiagnosis, title: str) -> str:
    """Self-contained HTML."""
    points, base = found.points, found.base
    mark = "fail" if found.verdict == "unknown-cause" else "pass"
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title><style>{CSS}</style>",
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="answer {mark}">{html.escape(sentence_of(found))}</p>',
        _picture(figure(found), "points of rest, what (3) and the extended model say of them, and the errors of both"),
        "<h2>The points</h2>",
    ]
    after = found.members[0].fit.residual_a if found.members else base.residual_a
    rows = [
        [
            f"{1e3 * x:.3f}",
            f"{1e3 * i:.1f}",
            f"{1e3 * off:+.1f}",
            f"{100 * off / i:+.1f}",
            f"{1e3 * place:+.2f}",
            f"{1e3 * left:+.1f}",
            f"{1e3 * cv:+.1f}",
        ]
        for x, i, off, place, left, cv in zip(
            points.x_m,
            points.i_c_a,
            base.residual_a,
            found.base_off_m,
            after,
            found.members[0].left_out_a if found.members else found.base_left_out_a,
            strict=True,
        )
    ]
    head = [
        "x, mm",
        "i_c, mA",
        "(3) off, mA",
        "%",
        "as position, mm",
        "extended off, mA",
        "predicted from the others, off, mA",
    ]
    parts.append(table(head, rows))
    if found.members:
        first = found.members[0]
        parts.append("<h2>What explains it</h2>")
        parts.append(
            table(
                ["", "size (95 %)", "K_c, N m^2/A^2", "off, mA rms", "unstable pole at mid-travel, 1/s"],
                [
                    [
                        html.escape(one.name),
                        html.escape(named(one).partition(": ")[2]),
                        f"{one.fit.theta.K_c:.3g}",
                        f"{1e3 * rms(one.fit.residual_a):.1f}",
                        f"{one.pole_per_s:.1f} ± {one.pole_std_per_s:.1f}",
                    ]
                    for one in found.members
                ],
            )
        )
        parts.append(
            paragraph(
                f"F = {first.F:.0f} with 1 and {first.fit.freedom} degrees of freedom: by chance {first.p:.2g}, and"
                f" {len(found.members) + len(found.others)} causes were tried."
            )
        )
        if len(found.members) > 1:
            parts.append("<h2>What would tell them apart</h2>")
            lines = []
            for other in found.members[1:]:
                what, z, _ = proposal_for(first, other)
                lines.append(f"{first.name} or {other.name}: {what}" + (f" (z = {z:.0f})" if z >= 1.0 else ""))
            parts.append(bullets(lines))
    if found.others:
        parts.append("<h2>Tried, and worse</h2>")
        parts.append(bullets([f"{one.name}: {why_not(found, one)}" for one in found.others]))
    parts.append("<h2>Not testable with points of rest</h2>")
    parts.append(bullets([f"{name}: {why}" for name, why in not_testable(found)]))
    if found.warnings:
        parts.append("<h2>Remarks</h2>" + bullets(found.warnings))
    parts.append("</html>")
    return "\n".join(parts) + "\n"


def figure(found: StaticDiagnosis) -> Figure:
    """Currents over x, errors over x."""
    drawn = Figure(figsize=(9.6, 3.8), layout="constrained")
    left, right = drawn.subplots(1, 2)
    plant, points = found.plant, found.points
    x = np.linspace(0.0, plant.travel_m, 80)
    models = [("(3), K_c at its best", found.base, "#c0392b")]
    if found.members:
        models.append((f"with {found.members[0].name}", found.members[0].fit, "#2a7f3f"))
    for label, fit, colour in models:
        left.plot(1e3 * x, holding_currents(fit.theta, plant, x), color=colour, label=label)
        right.plot(1e3 * points.x_m, 1e3 * fit.residual_a, "o", color=colour, label=label)
        right.vlines(1e3 * points.x_m, 0.0, 1e3 * fit.residual_a, color=colour, alpha=0.4)
    left.plot(1e3 * points.x_m, points.i_c_a, "ks", label="measured")
    left.set(xlabel="x, mm", ylabel="current that holds the ball, A", ylim=(0.0, None))
    right.axhline(0.0, color="k", lw=0.8)
    right.set(xlabel="x, mm", ylabel="measured - model, mA")
    left.legend()
    right.legend()
    return drawn


def _picture(drawn: Figure, about: str) -> str:
    data = io.BytesIO()
    drawn.savefig(data, format="png", dpi=_DPI)
    return image(data.getvalue(), about)
