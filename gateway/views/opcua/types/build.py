"""Builds nodes in bulk: objects, variables, properties and methods, as AddNodes items.

asyncua's own calls read and write each attribute, which takes 2 ms per node.  A site of eight boards has 3000 nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.extras import Extra
from gateway.views.opcua.address_space.model import Argument, Leaf
from gateway.views.opcua.address_space.quality import WAITING
from gateway.views.opcua.address_space.values import data_value
from gateway.views.opcua.address_space.words import PROPERTIES

READ = 1 << ua.AccessLevel.CurrentRead
WRITE = 1 << ua.AccessLevel.CurrentWrite
HISTORY = 1 << ua.AccessLevel.HistoryRead
VALUE = ua.AttributeIds.Value
_O = ua.ObjectIds
_SEVERAL = 1  # value rank of an array


@dataclass(frozen=True, slots=True, kw_only=True)
class Namespaces:
    """Indices of the namespaces in this server."""

    site: int
    types: int
    di: int
    machinery: int


class Builder:
    """Adds nodes to one namespace.

    Args:
        server: asyncua's.
        spaces: indices of all namespaces.
        index: of the namespace of the node ids.
        declares: whether the nodes are the instance declarations of a type, each with its modelling rule.
    """

    def __init__(self, server: InternalServer, spaces: Namespaces, index: int, *, declares: bool = False) -> None:
        self._server, self.spaces, self.index, self._declares = server, spaces, index, declares

    def id(self, path: str) -> ua.NodeId:
        """Return the node id of a path."""
        return ua.NodeId(path, self.index)

    def name(self, path: str) -> ua.QualifiedName:
        """Return the last chunk of a path as a name.

        Below a rig it is in the namespace of the types, for a rig or a site in that of the site.
        """
        _, slash, last = path.rpartition("/")
        return ua.QualifiedName(last, self.spaces.types if slash else self.index)

    def object(
        self,
        parent: ua.NodeId,
        path: str,
        description: str,
        *,
        kind: ua.NodeId | int = _O.BaseObjectType,
        events: bool = False,
        reference: int = _O.HasComponent,
        name: ua.QualifiedName | None = None,
    ) -> ua.NodeId:
        """Add an object; without a name it is named by the last chunk of its path."""
        attributes = ua.ObjectAttributes(EventNotifier=int(events))
        _describe(attributes, path, description, name)
        return self.add(parent, path, ua.NodeClass.Object, attributes, reference, kind, name=name)

    def variable(
        self,
        parent: ua.NodeId,
        path: str,
        value: Leaf | Extra,
        *,
        access: int = READ,
        kind: int = _O.BaseDataVariableType,
        data_type: ua.NodeId | None = None,
        min_sampling_ms: float = 0.0,
    ) -> ua.NodeId:
        """Add a variable without a value; its status says so until the first value."""
        attributes = _variable(value.variant, is_array=value.is_array, access=access)
        attributes.MinimumSamplingInterval = min_sampling_ms
        attributes.DataType = data_type or attributes.DataType
        _describe(attributes, path, value.description)
        node = self.add(parent, path, ua.NodeClass.Variable, attributes, _O.HasComponent, kind)
        self.await_value(node, value.variant)
        return node

    def property(
        self,
        parent: ua.NodeId,
        path: str,
        value: Any,
        variant: ua.VariantType,
        data_type: int,
        *,
        description: str = "",
        name: ua.QualifiedName | None = None,
    ) -> ua.NodeId:
        """Add a property; without a value its status says so.  The default name is that of the standard."""
        attributes = _variable(variant, is_array=isinstance(value, list), access=READ)
        attributes.DataType = ua.NodeId(data_type)
        attributes.Value = ua.Variant(value, variant if value is not None else ua.VariantType.Null)
        last = path.rpartition("/")[2]
        name = name or ua.QualifiedName(last, 0)
        _describe(attributes, path, description or PROPERTIES[last], name)
        kind = _O.PropertyType
        node = self.add(parent, path, ua.NodeClass.Variable, attributes, _O.HasProperty, kind, name=name)
        if value is None:
            self.await_value(node, variant)
        return node

    def await_value(self, node: ua.NodeId, variant: ua.VariantType) -> None:
        """Let the node say that its value has not come yet."""
        self._server.aspace[node].attributes[VALUE].value = data_value(None, variant, WAITING, 0)

    def method(
        self, parent: ua.NodeId, path: str, description: str, inputs: Sequence[Argument], outputs: Sequence[Argument]
    ) -> ua.NodeId:
        """Add a method; `sessions.py` carries it out."""
        attributes = ua.MethodAttributes(Executable=True, UserExecutable=True)
        _describe(attributes, path, description)
        node = self.add(parent, path, ua.NodeClass.Method, attributes, _O.HasComponent, None)
        for name, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
            if arguments:
                values = [_argument(argument) for argument in arguments]
                self.property(node, f"{path}/{name}", values, ua.VariantType.ExtensionObject, _O.Argument)
        return node

    def add(
        self,
        parent: ua.NodeId,
        path: str,
        node_class: ua.NodeClass,
        attributes: Any,
        reference: int,
        kind: ua.NodeId | int | None,
        *,
        name: ua.QualifiedName | None = None,
    ) -> ua.NodeId:
        """Add any node; `kind` is its type definition.  Of a type's declarations those of the twin are optional."""
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = self.id(path)
        item.BrowseName = name or self.name(path)
        item.NodeClass = node_class
        item.ParentNodeId = parent
        item.ReferenceTypeId = ua.NodeId(reference)
        if kind is not None:
            item.TypeDefinition = kind if isinstance(kind, ua.NodeId) else ua.NodeId(kind)
        item.NodeAttributes = attributes
        for result in self._server.node_mgt_service.add_nodes([item]):
            result.StatusCode.check()
        _, slash, below = path.partition("/")
        if self._declares and slash:
            optional = below == "twin" or below.startswith("twin/")
            rule = _O.ModellingRule_Optional if optional else _O.ModellingRule_Mandatory
            self.refer(item.RequestedNewNodeId, _O.HasModellingRule, ua.NodeId(rule), both=False)
        return item.RequestedNewNodeId

    def refer(self, source: ua.NodeId, reference: int, target: ua.NodeId, *, both: bool = True) -> None:
        """Add a reference, with `both` also its inverse."""
        ends = ((source, target, True), (target, source, False))
        for start, end, forward in ends if both else ends[:1]:
            item = ua.AddReferencesItem()
            item.SourceNodeId, item.TargetNodeId, item.IsForward = start, end, forward
            item.ReferenceTypeId, item.TargetNodeClass = ua.NodeId(reference), ua.NodeClass.Unspecified
            for status in self._server.node_mgt_service.add_references([item]):
                status.check()


def _describe(attributes: Any, path: str, description: str, name: ua.QualifiedName | None = None) -> None:
    attributes.DisplayName = ua.LocalizedText(name.Name if name is not None else path.rpartition("/")[2])
    attributes.Description = ua.LocalizedText(description)


def _variable(variant: ua.VariantType, *, is_array: bool, access: int) -> ua.VariableAttributes:
    return ua.VariableAttributes(
        DataType=ua.NodeId(variant.value),
        ValueRank=_SEVERAL if is_array else -1,
        AccessLevel=access,
        UserAccessLevel=access,
        Historizing=bool(access & HISTORY),
    )


def _argument(argument: Argument) -> ua.Argument:
    return ua.Argument(
        Name=argument.name,
        DataType=ua.NodeId(argument.variant.value),
        ValueRank=_SEVERAL if argument.is_array else -1,
        ArrayDimensions=[],
        Description=ua.LocalizedText(argument.description),
    )
