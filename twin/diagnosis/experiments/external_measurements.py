"""Measurements with other instruments that distinguish two causes if the board's recordings cannot."""

from __future__ import annotations

from twin.model.causes.catalogue import BY_NAME


def measurement_for(name: str, confounder: str) -> str:
    """The measurement that distinguishes two causes; without one in the catalogue, how to confirm each by hand."""
    cause, other = BY_NAME[name], BY_NAME[confounder]
    known = cause.deciding_measurements.get(confounder) or other.deciding_measurements.get(name)
    return known or f"for {name}: {cause.confirm}; for {confounder}: {other.confirm}"
