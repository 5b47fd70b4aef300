"""Types of the OPC UA server: RigType in the product's namespace, and what it needs of DI and Machinery.

The NodeSet2 files in `protocol/opcua` are the source of all names, types, units and descriptions.  Type and rigs cannot
differ: a rig is a copy.  `tests/gateway/views/test_opcua_types.py` compares the file with the messages of the bus.
Other nodes of the site (`Builder`) are AddNodes items: asyncua's own calls read and write each attribute, which takes
2 ms per node.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.quality import WAITING
from gateway.views.opcua.address_space.values import data_value

VALUE = ua.AttributeIds.Value
TYPES = "urn:board51:opcua:types"
DI = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
RIG_TYPE = "RigType"
MACHINES = 1001  # folder of all machines, of OPC UA for Machinery
_COMPANIONS, _TYPES = "companions.NodeSet2.xml", "board51.NodeSet2.xml"
_A, _O = ua.AttributeIds, ua.ObjectIds
_HISTORY = 1 << ua.AccessLevel.HistoryRead
_RULE, _PROPERTY = ua.NodeId(_O.HasModellingRule), ua.NodeId(_O.PropertyType)


@dataclass(frozen=True, slots=True, kw_only=True)
class Namespaces:
    """Indices of the namespaces in this server."""

    site: int
    types: int
    machinery: int


class Builder:
    """Adds nodes to the namespace of the site."""

    def __init__(self, server: InternalServer, spaces: Namespaces) -> None:
        self._server, self.spaces = server, spaces

    def id(self, path: str) -> ua.NodeId:
        """Return the node id of a path."""
        return ua.NodeId(path, self.spaces.site)

    def object(
        self,
        parent: ua.NodeId,
        path: str,
        description: str,
        *,
        kind: ua.NodeId | None = None,
        events: bool = False,
        reference: int = _O.HasComponent,
    ) -> ua.NodeId:
        """Add an object, named by the last chunk of its path.

        Below a rig the name is in the namespace of the types, for a rig or a site in that of the site.
        """
        _, slash, last = path.rpartition("/")
        attributes = ua.ObjectAttributes(
            DisplayName=ua.LocalizedText(last), Description=ua.LocalizedText(description), EventNotifier=int(events)
        )
        name = ua.QualifiedName(last, self.spaces.types if slash else self.spaces.site)
        kind = kind or ua.NodeId(_O.BaseObjectType)
        return self.add(parent, path, name, ua.NodeClass.Object, attributes, reference, kind)

    def add(
        self,
        parent: ua.NodeId,
        path: str,
        name: ua.QualifiedName,
        node_class: ua.NodeClass,
        attributes: Any,
        reference: int,
        kind: ua.NodeId,
    ) -> ua.NodeId:
        """Add any node; `kind` is its type definition."""
        item = ua.AddNodesItem(
            ParentNodeId=parent, ReferenceTypeId=ua.NodeId(reference), RequestedNewNodeId=self.id(path),
            BrowseName=name, NodeClass=node_class, NodeAttributes=attributes, TypeDefinition=kind,
        )  # fmt: skip
        for result in self._server.node_mgt_service.add_nodes([item]):
            result.StatusCode.check()
        return item.RequestedNewNodeId

    def refer(self, source: ua.NodeId, reference: int, target: ua.NodeId) -> None:
        """Add a reference and its inverse."""
        for start, end, forward in ((source, target, True), (target, source, False)):
            item = ua.AddReferencesItem(
                SourceNodeId=start, ReferenceTypeId=ua.NodeId(reference), IsForward=forward, TargetNodeId=end
            )
            for status in self._server.node_mgt_service.add_references([item]):
                status.check()


def nodeset(file: str = _TYPES) -> str:
    """Return a NodeSet2 file: by default the one of our types, for clients and engineering tools."""
    return (files("protocol") / "opcua" / file).read_text(encoding="utf-8")


async def register(server: Server) -> Namespaces:
    """Register the namespaces of the types behind those of the server, and add the types.

    The site's namespace must have been registered: clients count on its number.
    """
    site = len(await server.get_namespace_array()) - 1
    types, _, machinery = [await server.register_namespace(uri) for uri in (TYPES, DI, MACHINERY)]
    for file in (_COMPANIONS, _TYPES):
        for node in await server.import_xml(xmlstring=nodeset(file)):
            _complete(server.iserver.aspace[node])
    return Namespaces(site=site, types=types, machinery=machinery)


def _complete(node: NodeData) -> None:
    """Add what asyncua does not read from a file: that a variable has a history, waits for a value, or is empty."""
    if VALUE in node.attributes:
        access = node.attributes[_A.AccessLevel].value.Value.Value
        _set(node, _A.Historizing, bool(access & _HISTORY), ua.VariantType.Boolean)
        if node.attributes[VALUE].value.Value.Value is None:
            is_declaration = any(reference.ReferenceTypeId == _RULE for reference in node.references)
            missing = data_value(None, ua.VariantType.Null, WAITING, 0)
            node.attributes[VALUE].value = missing if is_declaration else ua.DataValue(ua.Variant(""))


def instantiate(space: AddressSpace, kind: ua.NodeId, rig: ua.NodeId, *, interval_ms: float) -> None:
    """Copy all that is declared below a type to an instance; the path of a node begins with its rig instead.

    The node of the rig exists.  `interval_ms` is the shortest interval of the values.
    """
    below = f"{kind.Identifier}/"
    ids = {kind: rig} | {
        node: ua.NodeId(f"{rig.Identifier}/{node.Identifier.removeprefix(below)}", rig.NamespaceIndex)
        for node in space.keys()
        if node.NamespaceIndex == kind.NamespaceIndex and str(node.Identifier).startswith(below)
    }
    name = space[rig].attributes[_A.BrowseName].value.Value.Value
    top = {
        "BrowseName": name,
        "DisplayName": ua.LocalizedText(name.Name),
        "NodeClass": ua.NodeClass.Object,
        "TypeDefinition": kind,
    }
    for declared, copy in ids.items():
        source, node = space[declared], space[rig] if copy == rig else NodeData(copy)
        node.references += [
            replace(r, NodeId=ids.get(r.NodeId, r.NodeId), **(top if r.NodeId == kind else {}))
            for r in source.references
            if r.ReferenceTypeId != _RULE and (r.NodeId in ids or copy != rig)
        ]
        if copy != rig:
            node.attributes = {a: AttributeValue(held.value) for a, held in source.attributes.items()}
            _set(node, _A.NodeId, copy, ua.VariantType.NodeId)
            if VALUE in node.attributes and all(r.NodeId != _PROPERTY for r in source.references):
                _set(node, _A.MinimumSamplingInterval, interval_ms, ua.VariantType.Double)
            space[copy] = node


def _set(node: NodeData, attribute: ua.AttributeIds, value: object, variant: ua.VariantType) -> None:
    node.attributes[attribute] = AttributeValue(ua.DataValue(ua.Variant(value, variant)))
