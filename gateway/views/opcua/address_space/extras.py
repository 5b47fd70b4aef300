"""Variables of a board beyond its topics: state of the link, alarms, last command."""

from __future__ import annotations

from typing import NamedTuple

from asyncua import ua

from gateway.views.feed import BoardFeed
from gateway.views.opcua.address_space import quality
from gateway.views.opcua.address_space.values import Value, data_value

_V = ua.VariantType
LINK_STATES = ("live", "silent", "absent", "handshake", "connecting", "streaming", "no-gateway")  # by number
LINK_CODE = "link/code"


class Extra(NamedTuple):
    """A variable of a board beyond its topics."""

    path: str
    variant: ua.VariantType
    is_array: bool
    description: str


EXTRAS = (
    Extra("link/state", _V.String, False, "live, or silent, absent, handshake, connecting, no-gateway"),
    Extra(LINK_CODE, _V.Int32, False, "link/state as a number: 0 is live"),
    Extra("link/reason", _V.String, False, "reason of the state, a sentence; empty while live"),
    Extra("alarms/active", _V.UInt32, False, "number of conditions that hold now"),
    Extra("alarms/unacknowledged", _V.UInt32, False, "number of conditions that nobody has acknowledged"),
    Extra("alarms/list", _V.String, True, "name, severity, state, text of each; the most urgent first"),
    Extra("last_command/who", _V.String, False, "sender of the newest command to this board, by any route"),
    Extra("last_command/what", _V.String, False, "kind of the newest command"),
    Extra("last_command/accepted", _V.Boolean, False, "whether the newest command was accepted"),
    Extra("last_command/reason", _V.String, False, "why it was refused, kebab-case"),
    Extra("last_command/text", _V.String, False, "why it was refused, a sentence"),
)


def extra(feed: BoardFeed, path: str) -> object:
    """Return the current value, or None if there is none."""
    match path:
        case "link/state":
            return feed.link().state
        case "link/code":
            state = feed.link().state
            return LINK_STATES.index(state) if state in LINK_STATES else None
        case "link/reason":
            return feed.link().reason
        case "alarms/active":
            return sum(alarm.active for alarm in feed.alarms())
        case "alarms/unacknowledged":
            return sum(not alarm.acknowledged for alarm in feed.alarms())
        case "alarms/list":
            return [
                f"{a.name}: {a.severity}, {'active' if a.active else 'gone'},"
                f" {'acknowledged' if a.acknowledged else 'not acknowledged'}: {a.text}"
                for a in feed.alarms()
            ]
    records = feed.commands()
    if not records:
        return None
    record = records[-1]
    return {
        "who": record.command.who,
        "what": record.command.WhichOneof("what") or "",
        "accepted": record.reply.accepted,
        "reason": record.reply.reason,
        "text": record.reply.text,
    }[path.partition("/")[2]]


def extra_value(feed: BoardFeed, path: str, variant: ua.VariantType, now_ns: int) -> Value:
    """Return a value with its time: that of the answer for a command, otherwise now."""
    value = extra(feed, path)
    if path.startswith("last_command/"):
        records = feed.commands()
        now_ns = records[-1].answered_ns if records else 0
    return data_value(value, variant, quality.GOOD if value is not None else quality.WAITING, now_ns)
