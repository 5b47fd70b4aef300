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
from gateway.views.opcua.types import VALUE, Builder

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
            held = self._space[reference.NodeId].attributes
            browse_name, node_class = (held[a].value.Value.Value for a in (_A.BrowseName, _A.NodeClass))
            name, text = prefix + browse_name.Name, ua.LocalizedText(browse_name.Name)
            if node_class == ua.NodeClass.Method:
                if _is_mandatory(self._space, reference.NodeId):
                    self._builder.refer(parent, reference.ReferenceTypeId.Identifier, reference.NodeId)
                continue
            attributes: Any
            if node_class == ua.NodeClass.Object:
                if not any(field.startswith(f"{name}/") for field in event.data_types):
                    continue
                attributes = ua.ObjectAttributes(DisplayName=text, Description=text, EventNotifier=0)
            elif name not in self._variables and getattr(event, name, None) is not None:  # a subtype repeats some
                copied = {a.name: held[a].value.Value.Value for a in (_A.DataType, _A.ValueRank)}
                attributes = ua.VariableAttributes(DisplayName=text, Description=text, **copied)  # to be read
                self._variables[name] = self._builder.id(f"{path}/{browse_name.Name}")
            else:
                continue
            kind = next(r.NodeId for r in self._space[reference.NodeId].references if _is(r, _O.HasTypeDefinition))
            reference_type, below = reference.ReferenceTypeId.Identifier, f"{path}/{browse_name.Name}"
            node = self._builder.add(parent, below, browse_name, node_class, attributes, reference_type, kind)
            self._declarations(reference.NodeId, node, below, f"{name}/", event)


def _is(reference: Any, kind: int, *, forward: bool = True) -> bool:
    return bool(reference.IsForward == forward and reference.ReferenceTypeId == ua.NodeId(kind))


def _components(space: AddressSpace, node: ua.NodeId) -> Iterator[Any]:
    return (r for r in list(space[node].references) if _is(r, _O.HasComponent) or _is(r, _O.HasProperty))


def _is_mandatory(space: AddressSpace, node: ua.NodeId) -> bool:
    return any(_is(r, _O.HasModellingRule) and r.NodeId == _MANDATORY for r in space[node].references)
