"""Variables and methods of a board, generated from the topic table and the message descriptors.  Pure.

    <board>/state/x_m            the last value of each interval (1 / rate)
    <board>/state/x_m/min, /max  the lowest and highest tick within it: no spike is lost by the slower rate
    <board>/status/link, <board>/parameters/gains, <board>/twin/divergence/x_m.error, ...
    <board>/SetReference(x_ref_m), SetMode, SetGains, Excite, Capture, Stop, ...   one for each kind of pb.Command

The path is the node id (string, namespace of the site); descriptions are the comments of board51.proto.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from asyncua import ua
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from gateway.views.opcua.address_space.words import ARGUMENTS, METHODS
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics

TICK_TOPICS = ("state", "twin/state", "twin/divergence")  # decimated, with min and max, with history
TOPICS = (*TICK_TOPICS, "status", "parameters", "twin/model")
Statistic = Literal["last", "low", "high"]
VARIANTS: dict[int, ua.VariantType] = {
    FieldDescriptor.TYPE_DOUBLE: ua.VariantType.Double,
    FieldDescriptor.TYPE_STRING: ua.VariantType.String,
    FieldDescriptor.TYPE_BOOL: ua.VariantType.Boolean,
    FieldDescriptor.TYPE_UINT32: ua.VariantType.UInt32,
    FieldDescriptor.TYPE_UINT64: ua.VariantType.UInt64,
    FieldDescriptor.TYPE_ENUM: ua.VariantType.UInt32,  # MultiStateDiscreteType wants an unsigned number
}
_UNITS_NAMESPACE = "http://www.opcfoundation.org/UA/units/un/cefact"
# UNECE Recommendation 20 codes, as OPC UA wants them.  Longest ends first: x_ref_slew_m_s is a speed, not a time.
_UNITS: tuple[tuple[str, str, str, str], ...] = (
    ("_per_s", "C97", "1/s", "reciprocal second"),
    ("_percent", "P1", "%", "percent"),
    ("_m_s", "MTS", "m/s", "metre per second"),
    ("_ms", "C26", "ms", "millisecond"),
    ("_ns", "C47", "ns", "nanosecond"),
    ("_a", "AMP", "A", "ampere"),
    ("_m", "MTR", "m", "metre"),
    ("_v", "VLT", "V", "volt"),
    ("_s", "SEC", "s", "second"),
)
_OF_PARENT = frozenset({"error", "rolling_rmse", "rolling_mean"})  # of a signal's divergence: in the unit of the signal


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
    unit: ua.EUInformation | None
    words: tuple[str, ...]  # of an enumeration, by number
    description: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument:
    """An input of a method: a field of the command's message."""

    name: str
    variant: ua.VariantType
    is_array: bool
    description: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A method: one kind of command."""

    name: str  # SetReference
    act: str  # set_reference: its field in pb.Command, and its name in the table of rights
    description: str
    arguments: tuple[Argument, ...]


@cache
def leaves() -> tuple[Leaf, ...]:
    """Return all variables of the topics."""
    collected: list[Leaf] = []
    for topic in TOPICS:
        row = topics.TOPIC_OF_NAME[topic]
        collected += _leaves(row.message, row.message.DESCRIPTOR, topic, "")
    return tuple(collected)


@cache
def methods() -> tuple[Method, ...]:
    """Return the methods of all kinds of commands."""
    kinds = pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields
    return tuple(
        Method(
            name="".join(word.capitalize() for word in kind.name.split("_")),
            act=kind.name,
            description=METHODS[kind.name],
            arguments=tuple(_argument(kind.name, field) for field in _fields(kind)),
        )
        for kind in kinds
    )


def _leaves(message: type[Message], descriptor: Any, topic: str, prefix: str) -> list[Leaf]:
    collected: list[Leaf] = []
    for field in descriptor.fields:
        name = prefix + field.name
        description = comments().get(f"{descriptor.name}.{field.name}", "")
        if field.message_type is not None and not _is_map(field):
            collected += _leaves(message, field.message_type, topic, name + ".")
            continue
        variant = ua.VariantType.String if _is_map(field) else VARIANTS[field.type]
        is_array = _is_map(field) or field.is_repeated
        ticking = topic in TICK_TOPICS and variant is ua.VariantType.Double and field.name != "t_s"
        statistics: tuple[tuple[Statistic | None, str, str], ...] = ((None, "", ""),)
        if ticking:
            statistics = (("last", "", ""), ("low", "/min", "lowest tick: "), ("high", "/max", "highest tick: "))
        words = tuple(value.name for value in field.enum_type.values) if field.enum_type is not None else ()
        collected += [
            Leaf(
                path=f"{topic}/{name}{end}",
                topic=topic,
                field=name,
                message=message,
                variant=variant,
                is_array=is_array,
                statistic=statistic,
                unit=unit_of(name) if variant is ua.VariantType.Double else None,
                words=words,
                description=(lead + description).strip(": "),
            )
            for statistic, end, lead in statistics
        ]
    return collected


def _argument(act: str, field: Any) -> Argument:
    description = ARGUMENTS.get(f"{act}.{field.name}", "") or comments().get(
        f"{field.containing_type.name}.{field.name}", ""
    )
    if field.enum_type is not None:
        description = f"{', '.join(f'{v.number} {v.name}' for v in field.enum_type.values)}. {description}".strip()
    return Argument(name=field.name, variant=VARIANTS[field.type], is_array=field.is_repeated, description=description)


def _fields(field: Any) -> Any:
    return field.message_type.fields


def _is_map(field: Any) -> bool:
    return field.message_type is not None and bool(field.message_type.GetOptions().map_entry)


@cache
def comments() -> dict[str, str]:
    """`State.x_m` -> the comment behind the field in board51.proto."""
    text = (files("protocol.bus") / "board51.proto").read_text(encoding="utf-8")
    texts: dict[str, str] = {}
    message = ""
    for line in text.splitlines():
        opening = re.match(r"message (\w+) \{", line)
        message = opening[1] if opening else message
        field = re.search(r"(\w+) = \d+;\s*//\s*(.*)", line)
        if field and message:
            texts[f"{message}.{field[1]}"] = field[2].strip()
    return texts


def unit_of(field: str) -> ua.EUInformation | None:
    """Return the unit of a field such as `i_c_a` or `x_m.error`, by the end of its name; None for a plain number."""
    parent, _, name = field.rpartition(".")
    if parent and name in _OF_PARENT:
        name = parent
    for end, code, symbol, words in _UNITS:
        if name.endswith(end):
            return ua.EUInformation(
                NamespaceUri=_UNITS_NAMESPACE,
                UnitId=int.from_bytes(code.encode("ascii"), "big"),
                DisplayName=ua.LocalizedText(symbol),
                Description=ua.LocalizedText(words),
            )
    return None
