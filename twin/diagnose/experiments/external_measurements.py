"""What to measure beside the board where its own recordings cannot tell two causes apart."""

from __future__ import annotations

from twin.model.causes.catalogue import BY_NAME


def measurement_for(own: str, confounder: str) -> str:
    """The measurement that tells the two apart; where nobody has thought of one, what confirms either by hand."""
    one, other = BY_NAME[own], BY_NAME[confounder]
    known = one.told_from.get(confounder) or other.told_from.get(own)
    return known or f"for {own}: {one.confirm}; for {confounder}: {other.confirm}"
