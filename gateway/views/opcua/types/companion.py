"""The nodes of OPC UA for Devices (DI) and OPC UA for Machinery that the rigs need.

asyncua brings no file of these specifications.  Ids, names and types are theirs; what no rig has is left out, and the
metadata of both namespaces says so (IsNamespaceSubset).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.parameters import FIELDS
from gateway.views.opcua.types.build import Builder, Namespaces
from gateway.views.opcua.types.layout import MACHINE_IDENTIFICATION, MACHINES

DI = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
_O, _V = ua.ObjectIds, ua.VariantType
_FUNCTIONAL_GROUP, _ITEM_IDENTIFICATION = 1005, 1004
_NUMBERS = {  # numeric ids of the specifications, by path
    "FunctionalGroupType": _FUNCTIONAL_GROUP,
    "Machines": MACHINES,
    "MachineryItemIdentificationType": _ITEM_IDENTIFICATION,
    "MachineIdentificationType": MACHINE_IDENTIFICATION,
    "MachineryItemIdentificationType/Manufacturer": 6002,
    "MachineryItemIdentificationType/SerialNumber": 6003,
    "MachineryItemIdentificationType/Model": 6008,
    "MachineryItemIdentificationType/HardwareRevision": 6010,
    "MachineryItemIdentificationType/SoftwareRevision": 6011,
    "MachineIdentificationType/ProductInstanceUri": 6015,
    "MachineIdentificationType/DefaultInstanceBrowseName": 6030,
}
_MANDATORY = frozenset({"Manufacturer", "SerialNumber", "ProductInstanceUri"})
_METADATA_NUMBERS = {"di": range(15001, 15009), "machinery": (5001, 6033, 6034, 6032, 6031, 6035, 6036, 6037)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """The metadata of a namespace in Server/Namespaces."""

    uri: str
    version: str
    published: datetime
    is_subset: bool


METADATA = {
    "di": Metadata(uri=DI, version="1.04.0", published=datetime(2022, 11, 3, tzinfo=UTC), is_subset=True),
    "machinery": Metadata(uri=MACHINERY, version="1.04.0", published=datetime(2025, 7, 1, tzinfo=UTC), is_subset=True),
}


class _Numbered(Builder):
    """Adds nodes with the numbers of a specification."""

    numbers: dict[str, int]

    def id(self, path: str) -> ua.NodeId:
        """Return the node id of a path."""
        return ua.NodeId(self.numbers[path], self.index)


def add_companions(server: InternalServer, spaces: Namespaces) -> None:
    """Add the nodes of the companion specifications to an address space without them."""
    di, machinery = (_Numbered(server, spaces, index) for index in (spaces.di, spaces.machinery))
    di.numbers = machinery.numbers = _NUMBERS
    group = object_type(di, ua.NodeId(_O.FolderType), "FunctionalGroupType", "groups parameters and methods")
    item = object_type(machinery, group, "MachineryItemIdentificationType", "nameplate of a machine or a component")
    machine = object_type(machinery, item, "MachineIdentificationType", "nameplate of a machine")
    for path in _NUMBERS:
        owner, slash, field = path.partition("/")
        if slash and field in FIELDS:
            variant, _ = FIELDS[field]
            name = ua.QualifiedName(field, spaces.di)
            above = item if owner == "MachineryItemIdentificationType" else machine
            node = machinery.property(
                above, path, None, variant, int(variant), description=f"{field} of the item", name=name
            )
            rule = _O.ModellingRule_Mandatory if field in _MANDATORY else _O.ModellingRule_Optional
            machinery.refer(node, _O.HasModellingRule, ua.NodeId(rule), both=False)
    machinery.property(
        machine, "MachineIdentificationType/DefaultInstanceBrowseName",
        ua.QualifiedName("Identification", spaces.di), _V.QualifiedName, _O.QualifiedName, description="name of each",
        name=ua.QualifiedName("DefaultInstanceBrowseName", 0),
    )  # fmt: skip
    machinery.object(
        ua.NodeId(_O.ObjectsFolder),
        "Machines",
        "all machines of this server",
        kind=_O.FolderType,
        reference=_O.Organizes,
        name=ua.QualifiedName("Machines", spaces.machinery),
    )
    for which, builder in (("di", di), ("machinery", machinery)):
        metadata, numbers = METADATA[which], _METADATA_NUMBERS[which]
        paths = (metadata.uri, *(_below(metadata, name) for name in metadata_values(metadata)))
        builder.numbers = dict(zip(paths, numbers, strict=True))
        add_metadata(builder, metadata)


def object_type(builder: Builder, above: ua.NodeId, name: str, description: str) -> ua.NodeId:
    """Add an object type below another."""
    attributes = ua.ObjectTypeAttributes(
        DisplayName=ua.LocalizedText(name), Description=ua.LocalizedText(description), IsAbstract=False
    )
    return builder.add(above, name, ua.NodeClass.ObjectType, attributes, _O.HasSubtype, None)


def metadata_values(metadata: Metadata) -> dict[str, tuple[Any, ua.VariantType, int, str]]:
    """Return (value, variant, data type, description) of each property of NamespaceMetadataType (Part 5, 6.3.14)."""
    return {
        "NamespaceUri": (metadata.uri, _V.String, _O.String, "URI of the namespace"),
        "NamespaceVersion": (metadata.version, _V.String, _O.String, "version of the specification"),
        "NamespacePublicationDate": (metadata.published, _V.DateTime, _O.DateTime, "when it was published"),
        "IsNamespaceSubset": (
            metadata.is_subset,
            _V.Boolean,
            _O.Boolean,
            "whether nodes of the namespace are missing here",
        ),
        "StaticNodeIdTypes": ([], _V.Int32, _O.IdType, "types of node ids that are the same in all servers"),
        "StaticNumericNodeIdRange": ([], _V.String, _O.NumericRange, "numeric ids that are the same in all servers"),
        "StaticStringNodeIdPattern": ("", _V.String, _O.String, "string ids that are the same in all servers"),
    }


def add_metadata(builder: Builder, metadata: Metadata) -> ua.NodeId:
    """Add an entry to Server/Namespaces; its path is the URI, and its properties are below it."""
    node = builder.object(
        ua.NodeId(_O.Server_Namespaces),
        metadata.uri,
        f"namespace {metadata.uri}",
        kind=_O.NamespaceMetadataType,
        name=ua.QualifiedName(metadata.uri, builder.index),
    )
    for name, (value, variant, data_type, description) in metadata_values(metadata).items():
        builder.property(
            node,
            _below(metadata, name),
            value,
            variant,
            int(data_type),
            description=description,
            name=ua.QualifiedName(name, 0),
        )
    return node


def _below(metadata: Metadata, name: str) -> str:
    return f"{metadata.uri.rstrip('/')}/{name}"
