"""The report: one HTML page that needs nothing else, the same numbers as JSON, and a section of another report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from twin.frequency import figures
from twin.frequency.bode import Bode, Height, Measured
from twin.frequency.margins import Margin
from twin.frequency.residual_psd import ResidualSpectrum
from twin.frequency.responses import Curve
from twin.frequency.verdict import WORDS, Test
from twin.page.figures import inline
from twin.page.plain import plain
from twin.page.render import Mark, render
from twin.validation.report import Section

MARGINS = {
    "gain_low": ("gain may fall to, factor", "{:.2f}"),
    "gain_high": ("gain may rise to, factor", "{:.2f}"),
    "phase_deg": ("phase margin [degrees]", "{:.1f}"),
    "modulus": ("modulus margin, smallest |1 + L|", "{:.2f}"),
}


TEST_HEAD = (
    "response", "frequencies", "p of all", "refused frequencies [Hz]", "measured / model where it differs most",
    "would be explained by", "explained",
)  # fmt: skip
UNEXCITED = (
    "no recording in closed loop has a reference that repeats itself or sweeps, over a third of the travel at most"
)


def to_dict(result: Bode) -> dict[str, Any]:
    """The numbers of the page; a complex response as gain and phase, NaN as None."""
    return plain(
        {
            "explains": result.verdict.explains,
            "answer": result.verdict.sentence,
            "from_hz": result.verdict.from_hz,
            "to_hz": result.verdict.to_hz,
            "tests": [asdict(test) | {"failed": test.failed} for test in result.verdict.tests],
            "heights": [_height_dict(height) for height in result.heights],
            "residuals": [asdict(spectrum) for spectrum in result.residuals],
            "notes": list(result.notes),
        },
        digits=9,
    )


def _height_dict(height: Height) -> dict[str, Any]:
    return {
        "x_m": height.x_m,
        "recordings": list(height.recordings),
        "measured": {name: _measured_dict(item) for name, item in height.measured.items()},
        "model": {name: _curve_dict(item) for name, item in height.model.items()},
        "margins": {name: asdict(item) for name, item in height.margins.items()},
        "model_margins": {name: asdict(item) for name, item in height.model_margins.items()},
    }


def _measured_dict(m: Measured) -> dict[str, Any]:
    return {
        "f_hz": m.f_hz,
        "gain": np.abs(m.value),
        "phase_deg": np.degrees(np.angle(m.value)),
        "radius95": figures.radius(m),
        "coherence": m.coherence,
    }


def _curve_dict(c: Curve) -> dict[str, Any]:
    return {
        "f_hz": c.f_hz,
        "gain": np.abs(c.value),
        "phase_deg": np.degrees(np.unwrap(np.angle(c.value))),
        "gain_std": np.abs(c.value) * c.log_gain_std,
        "phase_std_deg": np.degrees(c.phase_std),
    }


def to_html(result: Bode, *, title: str) -> str:
    """The page."""
    p = result.model.parameters
    return render(
        "frequency/bode.html",
        title=title,
        answer=result.verdict.sentence,
        colour={True: "pass", False: "fail", None: ""}[result.verdict.explains],
        values=", ".join(f"{name} = {p[name].value:.5g} {p[name].unit}" for name in p),
        certain=any(item.std or item.ci95 for item in p.values()),
        notes=result.notes,
        head=TEST_HEAD,
        unexcited=UNEXCITED,
        tests=[_test_row(test) for test in result.verdict.tests],
        heights=[
            {
                "x": f"{height.x_m * 1e3:.2f} mm",
                "recordings": ", ".join(height.recordings),
                "picture": inline(figures.response_figure(height), f"responses at x = {height.x_m * 1e3:.2f} mm"),
                "sensitivities": inline(figures.sensitivity_figure(height), "sensitivities")
                if "S" in height.measured
                else None,
                "margins": _margin_rows(height.margins, height.model_margins),
            }
            for height in result.heights
        ],
        residuals=inline(figures.residual_figure(result.residuals), "spectra of the residuals")
        if result.residuals
        else None,
        wrong=[sentence for item in result.residuals if (sentence := residual_sentence(item))],
    )


def section(result: Bode) -> Section:
    """The answer with its tests and responses, for the page of `validate`."""
    tested = bool(result.verdict.tests)
    return Section(
        title="Frequency responses: does the model explain the loop?",
        answer=result.verdict.sentence if tested else UNEXCITED,
        tested=tested,
        head=TEST_HEAD,
        rows=[_test_row(test) for test in result.verdict.tests],
        pictures=[
            inline(figures.response_figure(height), f"frequency responses at x = {height.x_m * 1e3:.2f} mm")
            for height in result.heights
        ],
    )


def residual_sentence(item: ResidualSpectrum) -> str:
    """Say where the residuals are not the model's noise; '' if they are."""
    if not len(item.wrong_hz):
        return ""
    low, high, count = item.wrong_hz.min(), item.wrong_hz.max(), len(item.wrong_hz)
    power = np.interp(item.wrong_hz, item.f_hz, item.power)
    worst = int(np.argmax(np.abs(np.log(power))))
    where = f" at {count} frequencies from {low:.3g} to {high:.3g} Hz" if count > 1 else ""
    return (
        f"The residual of {item.channel} is not the model's noise{where}: it has {power[worst]:.2g} times its power at"
        f" {item.wrong_hz[worst]:.3g} Hz."
    )


def _test_row(test: Test) -> list[str | Mark]:
    return [
        f"{WORDS[test.name]}, x = {test.x_m * 1e3:.2f} mm",
        f"{len(test.f_hz)}",
        f"{test.p:.2g}" if test.p >= 1e-6 else "< 1e-6",
        ", ".join(f"{f:.3g}" for f in test.refused_hz) or "none",
        f"{test.worst_gain:.3f}, {test.worst_phase_deg:+.2g}° at {test.worst_hz:.3g} Hz",
        " / ".join(f"{form.text}: p = {form.p_left:.2g}" for form in test.forms),
        Mark("no" if test.failed else "yes", not test.failed),
    ]


def _margin_rows(measured: Mapping[str, Margin], model: Mapping[str, Margin]) -> list[list[str]]:
    if not measured:
        return []
    return [
        [
            title,
            _margin(measured[name], form, absent="not within the frequencies"),
            _margin(model[name], form, absent="none") if name in model else "-",
        ]
        for name, (title, form) in MARGINS.items()
    ]


def _margin(margin: Margin, form: str, *, absent: str) -> str:
    if not math.isfinite(margin.value):
        return absent
    if not math.isfinite(margin.low):
        return f"{form.format(margin.value)} (no interval)"
    return f"{form.format(margin.value)} ({form.format(margin.low)} to {form.format(margin.high)})"
