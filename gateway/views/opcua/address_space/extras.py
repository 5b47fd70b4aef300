"""Variables of a board beyond its topics: state of the link, alarms, last command."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from asyncua import ua

from gateway.views.board_feed import BoardFeed
from gateway.views.opcua.address_space import quality
from gateway.views.opcua.address_space.values import Value, data_value
from protocol.bus import board51_pb2 as pb

_V = ua.VariantType
# LinkState of the NodeSet2 file.
LINK_STATES = ("live", "silent", "absent", "handshake", "connecting", "streaming", "no-gateway")


class Extra(NamedTuple):
    """A variable of a board beyond its topics."""

    path: str
    variant: ua.VariantType
    read: Callable[[BoardFeed], object]  # the current value; None if there is none


def _link_code(feed: BoardFeed) -> int | None:
    state = feed.link().state
    return LINK_STATES.index(state) if state in LINK_STATES else None


def _lines(feed: BoardFeed) -> list[str]:
    return [
        f"{a.name}: {a.severity}, {'active' if a.active else 'gone'},"
        f" {'acknowledged' if a.acknowledged else 'not acknowledged'}: {a.text}"
        for a in feed.alarms()
    ]


def _newest(read: Callable[[pb.CommandRecord], object]) -> Callable[[BoardFeed], object]:
    return lambda feed: read(feed.commands()[-1]) if feed.commands() else None


EXTRAS = (
    Extra("link/state", _V.String, lambda feed: feed.link().state),
    Extra("link/code", _V.Int32, _link_code),
    Extra("link/reason", _V.String, lambda feed: feed.link().reason),
    Extra("alarms/active", _V.UInt32, lambda feed: sum(alarm.active for alarm in feed.alarms())),
    Extra("alarms/unacknowledged", _V.UInt32, lambda feed: sum(not alarm.acknowledged for alarm in feed.alarms())),
    Extra("alarms/list", _V.String, _lines),
    Extra("last_command/who", _V.String, _newest(lambda record: record.command.who)),
    Extra("last_command/what", _V.String, _newest(lambda record: record.command.WhichOneof("what") or "")),
    Extra("last_command/accepted", _V.Boolean, _newest(lambda record: record.reply.accepted)),
    Extra("last_command/reason", _V.String, _newest(lambda record: record.reply.reason)),
    Extra("last_command/text", _V.String, _newest(lambda record: record.reply.text)),
)


def extra_value(feed: BoardFeed, extra: Extra) -> Value:
    """Return a value with its time: that of the answer for a command, otherwise now."""
    value, stamp_ns = extra.read(feed), time.time_ns()
    if extra.path.startswith("last_command/"):
        records = feed.commands()
        stamp_ns = records[-1].answered_ns if records else 0
    return data_value(value, extra.variant, quality.GOOD if value is not None else quality.WAITING, stamp_ns)
