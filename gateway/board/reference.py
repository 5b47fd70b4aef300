"""The range of the reference: the same for all views.  Pure.

The gateway checks each command (limits.py), and the board checks it again.  A view shows and offers
the range that both accept.
"""

from __future__ import annotations

import math

from protocol.bus import board51_pb2 as pb

# A value that was typed in mm and converted to m may differ from the limit in its last bits: 5.2 * 1e-3 > 5.2e-3.  The
# same holds for volts.  One nanometre is far below a count of any converter.
SLACK = 1e-9
_RESOLUTION_M = 1e-6  # m: the resolution of what a view shows


def reference_range(parameters: pb.Parameters) -> tuple[float, float]:
    """Return the lowest and highest reference, m; the board's alone where the gateway does not state its limits."""
    low, high = sorted((parameters.x_ref_min_m, parameters.x_ref_max_m))
    if not parameters.gateway_x_ref_max_m:
        return low, high
    return max(low, parameters.gateway_x_ref_min_m), min(high, parameters.gateway_x_ref_max_m)


def reference_range_mm(parameters: pb.Parameters) -> tuple[float, float]:
    """Return the range as a view shows it: mm with three decimals, rounded inwards, so that both ends are accepted."""
    low, high = reference_range(parameters)
    return math.ceil((low - SLACK) / _RESOLUTION_M) / 1e3, math.floor((high + SLACK) / _RESOLUTION_M) / 1e3
