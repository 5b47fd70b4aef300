"""Margins of a loop gain against python-control's of the same loop."""

from __future__ import annotations

import control
import numpy as np
import pytest

from twin.frequency.margins import margins_of, with_intervals


def test_margins_are_those_of_python_control() -> None:
    """An unstable plant with a delay: two gain margins, one on each side."""
    plant = control.tf([8.0, 76.0, 120.0], [1.0, 0.0, -20.0, 0.0]) * control.tf(*control.pade(0.01, 3))
    f_hz = np.geomspace(0.05, 30.0, 60)

    margins = margins_of(f_hz, np.asarray(plant(2j * np.pi * f_hz)))

    gains, phases, sensitivities, *_ = control.stability_margins(plant, returnall=True)
    assert margins.gain_low == pytest.approx(max(g for g in gains if 0.0 < g < 1.0), rel=0.02)
    assert margins.gain_high == pytest.approx(min(g for g in gains if g > 1.0), rel=0.02)
    assert margins.phase_deg == pytest.approx(min(abs(p) for p in phases), abs=0.5)
    assert margins.modulus == pytest.approx(min(sensitivities), rel=0.02)


def test_a_margin_outside_the_frequencies_is_none_and_has_no_interval() -> None:
    f_hz = np.geomspace(1.0, 3.0, 8)
    loop = (10.0 / (1.0 + 1j * f_hz)).astype(complex)

    margins = with_intervals(f_hz, loop, [np.asarray(loop * (1.0 + 0.01 * k)) for k in range(-9, 10)])

    assert np.isnan(margins["phase_deg"].value)
    assert np.isnan(margins["gain_high"].low)
    assert margins["modulus"].low <= margins["modulus"].value <= margins["modulus"].high
