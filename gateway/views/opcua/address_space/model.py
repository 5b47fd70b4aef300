"""Variables and methods of a board, generated from the topic table and the message descriptors.  Pure.

    <board>/state/x_m            the last value of each interval (1 / rate)
    <board>/state/x_m/min, /max  the lowest and highest tick within it: no spike is lost by the slower rate
    <board>/status/link, <board>/parameters/gains, <board>/twin/divergence/x_m.error, ...
    <board>/SetReference(x_ref_m), SetMode, SetGains, Excite, Capture, Stop, ...  one for each kind of command that fits

The path is the node id (string, namespace of the site).  Names, units and descriptions are in the NodeSet2 file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from asyncua import ua
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.bus import topics

TICK_TOPICS = ("state", "twin/state", "twin/divergence")  # decimated, with min and max, with history
TOPICS = (*TICK_TOPICS, "status", "parameters", "plant", "twin/model")
Statistic = Literal["last", "low", "high"]
VARIANTS: dict[int, ua.VariantType] = {
    FieldDescriptor.TYPE_DOUBLE: ua.VariantType.Double,
    FieldDescriptor.TYPE_STRING: ua.VariantType.String,
    FieldDescriptor.TYPE_BOOL: ua.VariantType.Boolean,
    FieldDescriptor.TYPE_UINT32: ua.VariantType.UInt32,
    FieldDescriptor.TYPE_UINT64: ua.VariantType.UInt64,
    FieldDescriptor.TYPE_ENUM: ua.VariantType.UInt32,  # MultiStateDiscreteType wants an unsigned number
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaf:
    """A variable of a board."""

    path: str  # below the board: state/x_m, state/x_m/min
    topic: str
    field: str  # dotted within the message
    message: type[Message]
    variant: ua.VariantType
    is_array: bool
    statistic: Statistic | None  # None: not decimated


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument:
    """An input of a method: a field of the command's message."""

    name: str
    variant: ua.VariantType
    is_array: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A method: one kind of command."""

    name: str  # SetReference
    act: str  # set_reference: its field in pb.Command, and its name in the table of rights
    arguments: tuple[Argument, ...]


@cache
def leaves() -> tuple[Leaf, ...]:
    """Return all variables of the topics."""
    collected: list[Leaf] = []
    for topic in TOPICS:
        row = topics.TOPIC_OF_NAME[topic]
        collected += _leaves(row.message, row.message.DESCRIPTOR, topic, "")
    return tuple(collected)


_LATER = frozenset({"shelve_s"})  # fields younger than their method: its clients call it with the arguments they know


@cache
def methods() -> tuple[Method, ...]:
    """Return the methods of all kinds of commands but those whose messages have messages in them."""
    kinds: Any = pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields
    return tuple(
        Method(
            name="".join(word.capitalize() for word in kind.name.split("_")),
            act=kind.name,
            arguments=tuple(
                Argument(name=field.name, variant=VARIANTS[field.type], is_array=field.is_repeated)
                for field in kind.message_type.fields
                if field.name not in _LATER
            ),
        )
        for kind in kinds
        if not any(field.message_type for field in kind.message_type.fields)  # set_plant: the plant is read only
    )


def _leaves(message: type[Message], descriptor: Any, topic: str, prefix: str) -> list[Leaf]:
    collected: list[Leaf] = []
    for field in descriptor.fields:
        name = prefix + field.name
        if field.message_type is not None and not _is_map(field):
            collected += _leaves(message, field.message_type, topic, name + ".")
            continue
        variant = ua.VariantType.String if _is_map(field) else VARIANTS[field.type]
        is_array = _is_map(field) or field.is_repeated
        ticking = topic in TICK_TOPICS and variant is ua.VariantType.Double and field.name != "t_s"
        statistics: tuple[tuple[Statistic | None, str], ...] = ((None, ""),)
        if ticking:
            statistics = (("last", ""), ("low", "/min"), ("high", "/max"))
        collected += [
            Leaf(
                path=f"{topic}/{name}{end}",
                topic=topic,
                field=name,
                message=message,
                variant=variant,
                is_array=is_array,
                statistic=statistic,
            )
            for statistic, end in statistics
        ]
    return collected


def _is_map(field: Any) -> bool:
    return field.message_type is not None and bool(field.message_type.GetOptions().map_entry)
