"""Flights that come close to the pole of (3) are left out there: a few samples must not decide a fit."""

from __future__ import annotations

import numpy as np

from protocol.campaign import Plant
from twin.estimation.innovations import FLIES, USE_I
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.settings import diagnosis as settings

TRAVEL_M = 5.7e-3


def flown(x_max_m: float) -> tuple[np.ndarray[tuple[int], np.dtype[np.bool_]], Record]:
    """Return which samples of a flight up to 4.5 % below the top count as flight, and its record."""
    t = 2e-3 * np.arange(2000.0)
    i_c = np.random.default_rng(1).normal(0.6, 2e-3, 2000)
    x = np.asarray(TRAVEL_M * (0.515 + 0.44 * np.sin(2.0 * np.pi * 0.7 * t)), dtype=np.float64)
    record = Record(
        name="flight.csv", kind="closed-loop", use="fit", t=t, u_c=np.full(2000, 2.0), i_c=i_c, x=x, x_ref=x
    )
    plant = Plant(name="rig", mass_kg=8.28e-3, travel_m=TRAVEL_M, x_max_m=x_max_m, gravity_m_s2=9.81)
    series = gather([record], plant).series
    assert np.mean(series.flags[:2000] & USE_I != 0) > 0.99, "the current is as good there as anywhere"
    return np.asarray(series.flags[:2000] & FLIES != 0), record


def test_no_sample_next_to_the_pole_is_flight() -> None:
    flies, record = flown(TRAVEL_M)
    _, clear = flown(TRAVEL_M), flown(TRAVEL_M + 2.44e-3)[0]

    is_close = TRAVEL_M - record.x < settings.POLE_SHARE * TRAVEL_M
    assert is_close.sum() > 50
    assert not flies[is_close].any()
    assert clear[is_close].any(), "with the coil higher up the same flight is far from the pole"
    assert (flies == clear)[~is_close].all()
