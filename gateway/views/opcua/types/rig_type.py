"""RigType and its data types, in the product's namespace: what every rig of every site has.

Raise VERSION and PUBLISHED with each change, and export the file again (`board51 opcua --export-nodeset`); a test
compares it.
"""

from __future__ import annotations

from datetime import UTC, datetime

from asyncua import ua
from asyncua.server.address_space import AttributeValue
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.extras import LINK_STATES
from gateway.views.opcua.types.build import Builder, Namespaces
from gateway.views.opcua.types.companion import Metadata, add_companions, add_metadata, object_type
from gateway.views.opcua.types.layout import LINK_STATE, RIG_TYPE, Layout

TYPES = "urn:board51:opcua:types"
VERSION = "1.0.0"
PUBLISHED = datetime(2026, 11, 23, tzinfo=UTC)
_O, _V = ua.ObjectIds, ua.VariantType
_EVENTS = (_O.AlarmConditionType, _O.BaseEventType)


def add_types(server: InternalServer, spaces: Namespaces) -> None:
    """Add the companion specifications' nodes and ours to an address space without."""
    add_companions(server, spaces)
    plain = Builder(server, spaces, spaces.types)
    _add_link_state(server, plain)
    description = "a magnetic levitation rig with its link, its alarms, its commands and its simulated twin"
    rig = object_type(plain, ua.NodeId(_O.BaseObjectType), RIG_TYPE, description)
    for event in _EVENTS:
        plain.refer(rig, _O.GeneratesEvent, ua.NodeId(event), both=False)
    Layout(Builder(server, spaces, spaces.types, declares=True), rig, RIG_TYPE)
    add_metadata(plain, Metadata(uri=TYPES, version=VERSION, published=PUBLISHED, is_subset=False))


def _add_link_state(server: InternalServer, builder: Builder) -> None:
    description = ua.LocalizedText("whether samples arrive from a rig, and if not, the state of the link")
    attributes = ua.DataTypeAttributes(
        DisplayName=ua.LocalizedText(LINK_STATE), Description=description, IsAbstract=False
    )
    node = builder.add(ua.NodeId(_O.Enumeration), LINK_STATE, ua.NodeClass.DataType, attributes, _O.HasSubtype, None)
    fields = [ua.EnumField(Name=name, Value=n) for n, name in enumerate(LINK_STATES)]
    definition = ua.DataValue(ua.Variant(ua.EnumDefinition(Fields=fields), _V.ExtensionObject))
    server.aspace[node].attributes[ua.AttributeIds.DataTypeDefinition] = AttributeValue(definition)
    words = [ua.LocalizedText(name) for name in LINK_STATES]
    builder.property(node, f"{LINK_STATE}/EnumStrings", words, _V.LocalizedText, _O.LocalizedText)
