"""What a user may choose about a mirror; apart from the numerics, so that `--help` need not import them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Window, rate of false alarms, longest bridge, patience."""

    window_s: float = 1.0  # of the rolling figures, and of one alarm decision
    false_alarms_per_day: float = 0.1  # of each alarm, under a right model
    bridge_ticks_max: int = 10
    diagnosis_after_s: float = 30.0  # an alarm that lasts so long asks for a diagnosis; 0: never
