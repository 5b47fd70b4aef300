"""The nameplate of a rig and the ranges of its variables, from the parameters that its board sends.  Pure.

Nameplate, as OPC UA for Devices (DI) and Machinery want it: a board's IDENTITY has its firmware and its serial number,
and nothing of maker, model or hardware: these are empty.
EURange: normal operation.  For the reference, what gateway and board both let through; else what the converters span.
InstrumentRange: what the converter can represent; of the setpoint, what the board alone would take.
A variable without a range here has none in the address space: an empty range with a good status would be wrong.
"""

from __future__ import annotations

from asyncua import ua

from gateway.board.reference import reference_range
from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import COUNTS_MAX

_V = ua.VariantType
Span = tuple[float, float]  # lowest, highest
_ENDS = ("", "/min", "/max")
FIELDS = {
    "Manufacturer": _V.LocalizedText,
    "Model": _V.LocalizedText,
    "SerialNumber": _V.String,
    "ProductInstanceUri": _V.String,
    "HardwareRevision": _V.String,
    "SoftwareRevision": _V.String,
    "DeviceRevision": _V.String,
}


def nameplate(parameters: pb.Parameters) -> dict[str, ua.Variant]:
    """Value of each field of FIELDS."""
    serial = str(parameters.board_id) if parameters.board_id else ""
    texts = {
        "SerialNumber": serial,
        "ProductInstanceUri": f"urn:board51:board:{serial}" if serial else "",
        "SoftwareRevision": parameters.firmware,
    }
    return {
        name: ua.Variant(
            ua.LocalizedText(texts.get(name, "")) if variant is _V.LocalizedText else texts.get(name, ""), variant
        )
        for name, variant in FIELDS.items()
    }


def ranges(parameters: pb.Parameters) -> dict[str, Span]:
    """EURange by path below the board."""
    current = (0.0, COUNTS_MAX * abs(parameters.i_lsb_a))
    position = (min(0.0, parameters.x_ref_min_m), max(parameters.x_ref_max_m, COUNTS_MAX * abs(parameters.x_lsb_m)))
    voltage = (min(0.0, parameters.u_min_v), parameters.u_max_v)
    reference = reference_range(parameters)
    spans = {"setpoint/x_ref_m": reference}
    for field, span in (("i_c_a", current), ("x_m", position), ("u_c_v", voltage), ("x_ref_m", reference)):
        for topic in ("state", "twin/state"):
            spans |= {f"{topic}/{field}{end}": span for end in _ENDS}
        width = span[1] - span[0]  # two signals of this span differ by no more
        for figure, low in (
            (f"{field}.error", -width),
            (f"{field}.rolling_mean", -width),
            (f"{field}.rolling_rmse", 0.0),
        ):
            spans |= {f"twin/divergence/{figure}{end}": (low, width) for end in _ENDS if field != "x_ref_m"}
    return spans


def instrument_ranges(parameters: pb.Parameters) -> dict[str, Span]:
    """InstrumentRange by path below the board."""
    u_end_v = parameters.u_min_v + COUNTS_MAX * parameters.u_lsb_v
    return {
        "state/i_c_a": (0.0, COUNTS_MAX * abs(parameters.i_lsb_a)),
        "state/x_m": (0.0, COUNTS_MAX * abs(parameters.x_lsb_m)),
        "state/u_c_v": (min(parameters.u_min_v, u_end_v), max(parameters.u_min_v, u_end_v)),
        "setpoint/x_ref_m": (parameters.x_ref_min_m, parameters.x_ref_max_m),
    }
