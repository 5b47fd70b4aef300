"""The node of a condition: an instance of AlarmConditionType that shows what the newest event says of it.

It is made when the alarm is first raised, as a component of the rig's `alarms`, and stays; the rig refers to it by
HasCondition (Part 9, 5.12).  Of the type's declarations it has the mandatory ones and all that the events state.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from gateway.views.opcua.address_space.values import Value, notify
from gateway.views.opcua.types.build import VALUE, Builder

_O = ua.ObjectIds
_A = ua.AttributeIds
_MANDATORY = ua.NodeId(_O.ModellingRule_Mandatory)


class ConditionObject:
    """Builds and updates the nodes of one condition."""

    def __init__(self, space: AddressSpace, builder: Builder, rig: ua.NodeId, event: Any) -> None:
        self._space, self._builder = space, builder
        self._variables: dict[str, ua.NodeId] = {}  # by the name of the event's field
        path, description = event.NodeId.Identifier, f"the alarm {event.ConditionName}"
        kind = ua.NodeId(_O.AlarmConditionType)
        node = builder.object(builder.id(f"{rig.Identifier}/alarms"), path, description, kind=kind)
        builder.refer(rig, _O.HasCondition, node)
        while kind != ua.NodeId(_O.BaseObjectType):
            self._declarations(kind, node, path, "", event)
            kind = next(r.NodeId for r in space[kind].references if _is(r, _O.HasSubtype, forward=False))

    async def show(self, event: Any) -> None:
        """Take over the fields of an event."""
        for name, node in self._variables.items():
            held = ua.Variant(getattr(event, name), event.data_types[name])
            attribute = self._space[node].attributes[VALUE]
            attribute.value = Value(Value=held, SourceTimestamp=event.Time)
            await notify(attribute, attribute.value)

    def _declarations(self, declared: ua.NodeId, parent: ua.NodeId, path: str, prefix: str, event: Any) -> None:
        for reference in _components(self._space, declared):
            attributes = self._space[reference.NodeId].attributes
            browse_name = attributes[_A.BrowseName].value.Value.Value
            name = prefix + browse_name.Name
            if attributes[_A.NodeClass].value.Value.Value == ua.NodeClass.Method:
                if _is_mandatory(self._space, reference.NodeId):
                    self._builder.refer(parent, reference.ReferenceTypeId.Identifier, reference.NodeId)
            elif attributes[_A.NodeClass].value.Value.Value == ua.NodeClass.Object:
                if any(field.startswith(f"{name}/") for field in event.data_types):
                    node = self._object(parent, f"{path}/{browse_name.Name}", reference, browse_name)
                    self._declarations(reference.NodeId, node, f"{path}/{browse_name.Name}", f"{name}/", event)
            elif name not in self._variables and getattr(event, name, None) is not None:  # a subtype repeats some
                node = self._variable(parent, f"{path}/{browse_name.Name}", reference, browse_name)
                self._variables[name] = node
                self._declarations(reference.NodeId, node, f"{path}/{browse_name.Name}", f"{name}/", event)

    def _object(self, parent: ua.NodeId, path: str, reference: Any, browse_name: ua.QualifiedName) -> ua.NodeId:
        name = ua.LocalizedText(browse_name.Name)
        attributes = ua.ObjectAttributes(DisplayName=name, Description=name, EventNotifier=0)
        kind = next(r.NodeId for r in self._space[reference.NodeId].references if _is(r, _O.HasTypeDefinition))
        reference_type = reference.ReferenceTypeId.Identifier
        return self._builder.add(parent, path, browse_name, ua.NodeClass.Object, attributes, reference_type, kind)

    def _variable(self, parent: ua.NodeId, path: str, reference: Any, browse_name: ua.QualifiedName) -> ua.NodeId:
        declared, name = self._space[reference.NodeId], ua.LocalizedText(browse_name.Name)
        copied = {a.name: declared.attributes[a].value.Value.Value for a in (_A.DataType, _A.ValueRank)}
        attributes = ua.VariableAttributes(DisplayName=name, Description=name, **copied)  # to be read, by default
        kind = next(r.NodeId for r in declared.references if _is(r, _O.HasTypeDefinition))
        reference_type = reference.ReferenceTypeId.Identifier
        return self._builder.add(parent, path, browse_name, ua.NodeClass.Variable, attributes, reference_type, kind)


def _is(reference: Any, kind: int, *, forward: bool = True) -> bool:
    return bool(reference.IsForward == forward and reference.ReferenceTypeId == ua.NodeId(kind))


def _components(space: AddressSpace, node: ua.NodeId) -> Iterator[Any]:
    return (r for r in list(space[node].references) if _is(r, _O.HasComponent) or _is(r, _O.HasProperty))


def _is_mandatory(space: AddressSpace, node: ua.NodeId) -> bool:
    return any(_is(r, _O.HasModellingRule) and r.NodeId == _MANDATORY for r in space[node].references)
