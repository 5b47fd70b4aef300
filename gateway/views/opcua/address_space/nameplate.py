"""The nameplate of a rig, as OPC UA for Devices (DI) and Machinery want it: what the board says of itself.  Pure.

A board's IDENTITY has its firmware and its serial number, and nothing of maker, model or hardware: these are empty.
"""

from __future__ import annotations

from asyncua import ua

from protocol.bus import board51_pb2 as pb

_V = ua.VariantType
FIELDS: dict[str, tuple[ua.VariantType, str]] = {
    "Manufacturer": (_V.LocalizedText, "maker of the rig; empty: boards do not state it"),
    "Model": (_V.LocalizedText, "model of the rig; empty: boards do not state it"),
    "SerialNumber": (_V.String, "serial number of the board; empty where it has none"),
    "ProductInstanceUri": (_V.String, "unique name, made of the board's serial number; empty where it has none"),
    "HardwareRevision": (_V.String, "revision of the hardware; empty: boards do not state it"),
    "SoftwareRevision": (_V.String, "version and build of the board's firmware"),
    "DeviceRevision": (_V.String, "revision of the rig as a whole; empty: boards do not state it"),
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
        for name, (variant, _) in FIELDS.items()
    }
