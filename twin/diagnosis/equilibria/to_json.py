"""The sentences of a diagnosis from points of rest, and its form in diagnosis.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.diagnosis.equilibria.diagnosis import Explanation, StaticDiagnosis, parameters_of, proposal_for
from twin.diagnosis.equilibria.points import StaticFit
from twin.diagnosis.report.quantities import quantity
from twin.diagnosis.result import parameters_json
from twin.estimation.record import FloatArray
from twin.model.causes.catalogue import BY_NAME, CATALOGUE
from twin.page.plain import plain
from twin.settings import diagnosis as settings

_MIN_CURRENT_A = 1e-12  # points without any error, as by hand: no ratio divides by less


def sentence_of(diagnosis: StaticDiagnosis) -> str:
    """The answer, first."""
    n = len(diagnosis.points)
    base_a = diagnosis.base.residual_a
    worst = int(np.argmax(np.abs(base_a)))
    off, i = base_a[worst], diagnosis.points.i_c_a[worst]
    wrong = (
        f"With the best K_c, (3) is off by {1e3 * rms(base_a):.3g} mA rms over {n} points of rest,"
        f" most at x = {1e3 * diagnosis.points.x_m[worst]:.2f} mm: the ball needed {1e3 * off:+.0f} mA"
        f" ({100 * off / i:+.0f} % of its holding current) compared with (3)"
    )
    if diagnosis.verdict == "model-adequate":
        return f"These {n} points of rest do not contradict (3): it is off by {1e3 * rms(base_a):.3g} mA rms."
    if diagnosis.verdict == "unknown-cause":
        nearest = next((explanation for explanation in diagnosis.rejected if not explanation.fit.at_bound), None)
        removed = 0.0 if nearest is None else 1.0 - nearest.fit.rss_a2 / diagnosis.base.rss_a2
        if nearest is None or removed < settings.STATIC_NEARLY:
            return f"{wrong}; no single cause of the catalogue explains it."
        chance_percent = 100 * min(nearest.p * len(diagnosis.rejected), 1.0)
        return (
            f"{wrong}. {nearest.name} would remove {100 * removed:.0f} % of the squares, but {n} points are too few"
            f" to name it: of {len(diagnosis.rejected)} causes one does as much by chance"
            f" in {chance_percent:.0f} % of campaigns."
        )
    first = diagnosis.members[0]
    strength = BY_NAME[first.name].strength
    size = f"{strength.symbol} = {quantity(first.value, strength.unit)}"
    size += f" ({quantity(first.low, strength.unit)} to {quantity(first.high, strength.unit)})"
    also = ", ".join(explanation.name for explanation in diagnosis.members[1:])
    before, after = rms(diagnosis.base_left_out_a), rms(first.left_out_a)
    text = f"{wrong}. {BY_NAME[first.name].title[:1].upper()}{BY_NAME[first.name].title[1:]}, {size}, would explain it"
    text += f"; so would, as well, {also}." if also else "."
    return (
        f"{text} A point predicted from the others is then off by {1e3 * after:.3g} mA rms"
        f" instead of {1e3 * before:.3g} ({before / max(after, _MIN_CURRENT_A):.2g} times less)."
    )


def to_json(diagnosis: StaticDiagnosis) -> dict[str, Any]:
    """The contract of diagnosis.json, with what is special to points of rest under `static`.

    A number that is not finite, such as the unstable pole of a cause that holds the ball, is null.
    """
    base, first = diagnosis.base, diagnosis.members[0] if diagnosis.members else None
    floor = len(diagnosis.points) * diagnosis.rounding_a**2
    excess = max(base.rss_a2 - floor, 1e-300)
    remains = first.fit if first else base
    left = remains.rss_a2
    after = first.left_out_a if first else diagnosis.base_left_out_a
    worst = int(np.argmax(np.abs(remains.residual_a)))
    where = (
        f"{1e3 * remains.std_a:.2g} mA, most at x = {1e3 * diagnosis.points.x_m[worst]:.2f} mm;"
        f" rounding alone makes {1e3 * diagnosis.rounding_a:.2g} mA"
    )
    content = {
        "verdict": diagnosis.verdict,
        "sentence": sentence_of(diagnosis),
        "calibrated": True,
        "causes": [] if first is None else [_cause(diagnosis, first, min((base.rss_a2 - left) / excess, 1.0))],
        "candidates": [],
        "not_testable": [{"name": name, "why": why} for name, why in not_testable(diagnosis)],
        "ruled_out": [
            {"name": explanation.name, "why": why_not(diagnosis, explanation)} for explanation in diagnosis.rejected
        ],
        "jointly_explained": {"share_of_excess": 0.0},
        "unexplained": {
            "share_of_excess": 0.0
            if diagnosis.verdict == "model-adequate"
            else min(max(left - floor, 0.0) / excess, 1.0),
            "where": where,
        },
        "gain": {
            "horizon_samples": 0,
            "judge": None
            if diagnosis.judge is None
            else {"baseline_rmse_a": rms(diagnosis.judge[0]), "extended_rmse_a": rms(diagnosis.judge[1])},
            "why": "points of rest contain no motion to predict",
            "leave_one_out": {
                "baseline_rmse_a": rms(diagnosis.base_left_out_a),
                "extended_rmse_a": rms(after),
                "ratio": rms(after) / max(rms(diagnosis.base_left_out_a), _MIN_CURRENT_A),
                "noise_floor_a": diagnosis.rounding_a,
                "points": len(diagnosis.points),
            },
        },
        "plant_assumed": diagnosis.plant.assumed,
        "extended_model": {
            "is": "all-causes" if diagnosis.extended.causes else "reference",
            "causes": [cause.name for cause in diagnosis.extended.causes],
            "judged": True,
            "offered": bool(diagnosis.extended.causes),
            "refused": [],
        },
        "static": _rows(diagnosis, remains),
        "warnings": diagnosis.warnings,
    }
    return plain(content)


def _cause(diagnosis: StaticDiagnosis, first: Explanation, share: float) -> dict[str, Any]:
    """The cause that is named, with those that explain as much and what would tell them apart."""
    alternatives = diagnosis.members[1:]
    proposals = [proposal_for(first, other) for other in alternatives]
    return {
        "name": first.name,
        "sentence": named(first),
        "parameters": parameters_json(parameters_of(first)),
        "confidence": round(diagnosis.confidence, 3),
        "indistinguishable_from": [other.name for other in alternatives],
        "alternatives": [
            {
                "name": other.name,
                "parameters": parameters_json(parameters_of(other)),
                "rms_a": rms(other.fit.residual_a),
                "unstable_pole_per_s": other.pole_per_s,
                "told_apart_by": {"what": what, "separation_z": z, "command": command},
            }
            for other, (what, z, command) in zip(alternatives, proposals, strict=True)
        ],
        "share_of_excess_explained": share,
        "next_experiment": _best_proposal(proposals),
        "unstable_pole_per_s": first.pole_per_s,
    }


def _rows(diagnosis: StaticDiagnosis, remains: StaticFit) -> dict[str, Any]:
    """List each point with its readings and the error of each model."""
    base, first = diagnosis.base, diagnosis.members[0] if diagnosis.members else None
    return {
        "x_m": diagnosis.points.x_m,
        "i_c_a": diagnosis.points.i_c_a,
        "baseline_error_a": base.residual_a,
        "baseline_error_share": base.residual_a / diagnosis.points.i_c_a,
        "baseline_error_m": diagnosis.base_off_m,
        "extended_error_a": remains.residual_a,
        "reference_model_error_a": diagnosis.reference_off_a,
        "K_c": {"paper": base.theta.K_c, "extended": remains.theta.K_c},
        "F": None if first is None else first.F,
        "p": None if first is None else first.p,
        "degrees_of_freedom": remains.freedom,
    }


def not_testable(diagnosis: StaticDiagnosis) -> list[tuple[str, str]]:
    """Return (name, why) of every cause of the catalogue that points of rest do not show."""
    entries = []
    tested = {explanation.name for explanation in (*diagnosis.members, *diagnosis.rejected)}
    for cause in CATALOGUE:
        if cause.name in tested:
            continue
        if cause.not_testable:
            why = cause.not_testable
        elif cause.name in diagnosis.absorbed:
            why = "at rest K_c has the same effect"
        elif cause.at_rest == "amplifier":
            why = "i_c was measured, so the amplifier does not affect the force balance"
        else:
            why = f"nothing moves in these data ({', '.join(cause.shows_in) or 'no experiment'} would show it)"
        entries.append((cause.name, why))
    return entries


def why_not(diagnosis: StaticDiagnosis, explanation: Explanation) -> str:
    """Say why a cause that was tried is not in the class."""
    left = f"leaves {1e3 * rms(explanation.fit.residual_a):.3g} mA rms"
    strength = BY_NAME[explanation.name].strength
    if explanation.fit.at_bound:
        end = quantity(explanation.value, strength.unit)
        return f"{left} even with {strength.symbol} at the end of its physical range, {end}"
    if diagnosis.base.rss_a2 - explanation.fit.rss_a2 < 1e-3 * diagnosis.base.rss_a2:
        return "any size of it makes the balance worse"
    best = diagnosis.members[0].fit if diagnosis.members else None
    if best is None:
        return f"{left}; chance does that in {100 * explanation.p:.2g} % of such campaigns, and others were tried too"
    times = rms(explanation.fit.residual_a) / max(rms(best.residual_a), _MIN_CURRENT_A)
    return f"{left}, {times:.3g} times what {best.cause} leaves"


def named(explanation: Explanation) -> str:
    """The cause in plain words, with its size."""
    strength = BY_NAME[explanation.name].strength
    size = f"{strength.symbol} = {quantity(explanation.value, strength.unit)}"
    ends = f"{quantity(explanation.low, strength.unit)} to {quantity(explanation.high, strength.unit)}"
    return f"{BY_NAME[explanation.name].title}: {size} ({ends})"


def _best_proposal(proposals: Sequence[tuple[str, float, str]]) -> dict[str, Any] | None:
    if not proposals:
        return None
    # Members that are one to a measurement differ in the last digits: the first of them, then, not the luckiest.
    what, z, command = max(proposals, key=lambda proposal: round(proposal[1], 6))
    return {"what": what, "separation_z": z, "command": command}


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))
