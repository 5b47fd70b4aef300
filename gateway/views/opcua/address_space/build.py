"""Builds nodes in bulk: objects, variables, properties and methods, as AddNodes items.

asyncua's own calls read and write each attribute, which takes 2 ms per node.  A site of eight boards has 2500 nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from gateway.views.opcua.address_space.model import Argument, Leaf
from gateway.views.opcua.address_space.quality import WAITING
from gateway.views.opcua.address_space.ranges import RANGED
from gateway.views.opcua.address_space.values import data_value

READ = 1 << ua.AccessLevel.CurrentRead
WRITE = 1 << ua.AccessLevel.CurrentWrite
HISTORY = 1 << ua.AccessLevel.HistoryRead
_SEVERAL = 1  # value rank of an array


class Builder:
    """Adds nodes to one namespace."""

    def __init__(self, server: InternalServer, namespace: int) -> None:
        self._server, self._namespace = server, namespace

    def id(self, path: str) -> ua.NodeId:
        """The node id of a path."""
        return ua.NodeId(path, self._namespace)

    def folder(self, parent: ua.NodeId, path: str, about: str, *, events: bool = False) -> ua.NodeId:
        """An object; its name is the last chunk of the path."""
        attributes = ua.ObjectAttributes()
        attributes.EventNotifier = 1 if events else 0
        _name(attributes, path, about)
        kind = ua.ObjectIds.BaseObjectType
        return self._add(parent, path, ua.NodeClass.Object, attributes, ua.ObjectIds.HasComponent, kind)

    def variable(
        self,
        parent: ua.NodeId,
        path: str,
        variant: ua.VariantType,
        about: str = "",
        *,
        is_array: bool = False,
        access: int = READ,
        kind: int = ua.ObjectIds.BaseDataVariableType,
        min_sampling_ms: float = 0.0,
    ) -> ua.NodeId:
        """A variable without a value."""
        attributes = _variable(variant, is_array=is_array, access=access)
        attributes.MinimumSamplingInterval = min_sampling_ms
        _name(attributes, path, about)
        return self._add(parent, path, ua.NodeClass.Variable, attributes, ua.ObjectIds.HasComponent, kind)

    def leaf(self, parent: ua.NodeId, board: str, leaf: Leaf, *, history: bool, min_sampling_ms: float) -> ua.NodeId:
        """The variable of a leaf with its unit, range or words."""
        kind = ua.ObjectIds.BaseDataVariableType
        if leaf.unit is not None:
            kind = analog(leaf.path)
        elif leaf.words:
            kind = ua.ObjectIds.MultiStateDiscreteType
        path = f"{board}/{leaf.path}"
        node = self.variable(
            parent,
            path,
            leaf.variant,
            leaf.about,
            is_array=leaf.is_array,
            access=READ | HISTORY if history else READ,
            kind=kind,
            min_sampling_ms=min_sampling_ms,
        )
        if leaf.unit is not None:
            self.unit(node, path, leaf.unit, ranged=leaf.path in RANGED)
        if leaf.words:
            words = [ua.LocalizedText(word) for word in leaf.words]
            self.property(node, f"{path}/EnumStrings", words, ua.VariantType.LocalizedText, ua.ObjectIds.LocalizedText)
        return node

    def unit(self, node: ua.NodeId, path: str, unit: ua.EUInformation, *, ranged: bool) -> None:
        """EngineeringUnits, and an EURange that comes with the board's parameters."""
        units = ua.ObjectIds.EUInformation
        self.property(node, f"{path}/EngineeringUnits", unit, ua.VariantType.ExtensionObject, units)
        if ranged:
            self.property(node, f"{path}/EURange", None, ua.VariantType.ExtensionObject, ua.ObjectIds.Range)
            held = self._server.aspace[self.id(f"{path}/EURange")].attributes[ua.AttributeIds.Value]
            held.value = data_value(None, ua.VariantType.ExtensionObject, WAITING, 0)

    def property(self, parent: ua.NodeId, path: str, value: Any, variant: ua.VariantType, data_type: int) -> None:
        """A property with its value."""
        attributes = _variable(variant, is_array=isinstance(value, list), access=READ)
        attributes.DataType = ua.NodeId(data_type)
        attributes.Value = ua.Variant(value, variant if value is not None else ua.VariantType.Null)
        _name(attributes, path, "")
        self._add(
            parent, path, ua.NodeClass.Variable, attributes, ua.ObjectIds.HasProperty, ua.ObjectIds.PropertyType,
            standard_name=True,
        )  # fmt: skip

    def method(
        self, parent: ua.NodeId, path: str, about: str, inputs: Sequence[Argument], outputs: Sequence[Argument]
    ) -> ua.NodeId:
        """A method; what it does is decided in `sessions.py`."""
        attributes = ua.MethodAttributes()
        attributes.Executable = attributes.UserExecutable = True
        _name(attributes, path, about)
        node = self._add(parent, path, ua.NodeClass.Method, attributes, ua.ObjectIds.HasComponent, None)
        for name, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
            if arguments:
                values = [_argument(argument) for argument in arguments]
                self.property(node, f"{path}/{name}", values, ua.VariantType.ExtensionObject, ua.ObjectIds.Argument)
        return node

    def _add(
        self,
        parent: ua.NodeId,
        path: str,
        node_class: ua.NodeClass,
        attributes: Any,
        reference: int,
        kind: int | None,
        *,
        standard_name: bool = False,
    ) -> ua.NodeId:
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = self.id(path)
        item.BrowseName = ua.QualifiedName(path.rpartition("/")[2], 0 if standard_name else self._namespace)
        item.NodeClass = node_class
        item.ParentNodeId = parent
        item.ReferenceTypeId = ua.NodeId(reference)
        if kind is not None:
            item.TypeDefinition = ua.NodeId(kind)
        item.NodeAttributes = attributes
        for result in self._server.node_mgt_service.add_nodes([item]):
            result.StatusCode.check()
        return item.RequestedNewNodeId


def analog(path: str) -> int:
    """The type of a variable with a unit: AnalogItemType promises an EURange."""
    return int(ua.ObjectIds.AnalogItemType if path in RANGED else ua.ObjectIds.AnalogUnitType)


def _name(attributes: Any, path: str, about: str) -> None:
    attributes.DisplayName = ua.LocalizedText(path.rpartition("/")[2])
    attributes.Description = ua.LocalizedText(about)
    attributes.WriteMask = attributes.UserWriteMask = 0


def _variable(variant: ua.VariantType, *, is_array: bool, access: int) -> ua.VariableAttributes:
    attributes = ua.VariableAttributes()
    attributes.DataType = ua.NodeId(variant.value)
    attributes.ValueRank = _SEVERAL if is_array else -1
    attributes.AccessLevel = attributes.UserAccessLevel = access
    attributes.Historizing = bool(access & HISTORY)
    attributes.Value = ua.Variant(None, ua.VariantType.Null)
    return attributes


def _argument(argument: Argument) -> ua.Argument:
    made = ua.Argument()
    made.Name = argument.name
    made.DataType = ua.NodeId(argument.variant.value)
    made.ValueRank = _SEVERAL if argument.is_array else -1
    made.ArrayDimensions = []
    made.Description = ua.LocalizedText(argument.about)
    return made
