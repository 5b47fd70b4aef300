"""EURange of each variable, by path: the range of the converters; for the reference, the board's limits.  Pure.

A variable without a range here has no EURange in the address space: an empty range with a good status would be wrong.
"""

from __future__ import annotations

from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import COUNTS_MAX

_ENDS = ("", "/min", "/max")


def ranges(parameters: pb.Parameters) -> dict[str, tuple[float, float]]:
    """(lowest, highest) by path below the board."""
    current = (0.0, COUNTS_MAX * abs(parameters.i_lsb_a))
    position = (min(0.0, parameters.x_ref_min_m), max(parameters.x_ref_max_m, COUNTS_MAX * abs(parameters.x_lsb_m)))
    voltage = (min(0.0, parameters.u_min_v), parameters.u_max_v)
    reference = (parameters.x_ref_min_m, parameters.x_ref_max_m)
    found = {"setpoint/x_ref_m": reference}
    for field, span in (("i_c_a", current), ("x_m", position), ("u_c_v", voltage), ("x_ref_m", reference)):
        for topic in ("state", "twin/state"):
            found |= {f"{topic}/{field}{end}": span for end in _ENDS}
        width = span[1] - span[0]  # two signals of this span differ by no more
        for figure, low in (
            (f"{field}.error", -width),
            (f"{field}.rolling_mean", -width),
            (f"{field}.rolling_rmse", 0.0),
        ):
            found |= {f"twin/divergence/{figure}{end}": (low, width) for end in _ENDS if field != "x_ref_m"}
    return found


RANGED = frozenset(ranges(pb.Parameters()))  # paths that have one, whatever the board
