"""Measurements with other instruments that distinguish two causes if the board's recordings cannot."""

from __future__ import annotations

from twin.model.causes.catalogue import BY_NAME


def measurement_for(own: str, confounder: str) -> str:
    """The measurement that distinguishes two causes; without one in the catalogue, how to confirm each by hand."""
    one, other = BY_NAME[own], BY_NAME[confounder]
    known = one.deciding_measurements.get(confounder) or other.deciding_measurements.get(own)
    return known or f"for {own}: {one.confirm}; for {confounder}: {other.confirm}"
