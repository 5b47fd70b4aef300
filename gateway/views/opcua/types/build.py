"""Adds nodes of the site: objects, variables and references, as AddNodes items.

asyncua's own calls read and write each attribute, which takes 2 ms per node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer

VALUE = ua.AttributeIds.Value
_O = ua.ObjectIds


@dataclass(frozen=True, slots=True, kw_only=True)
class Namespaces:
    """Indices of the namespaces in this server."""

    site: int
    types: int
    di: int
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
            ParentNodeId=parent,
            ReferenceTypeId=ua.NodeId(reference),
            RequestedNewNodeId=self.id(path),
            BrowseName=name,
            NodeClass=node_class,
            NodeAttributes=attributes,
            TypeDefinition=kind,
        )
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
