"""The nodes of one board, kept up to date from its feed.

Rule 1: only subscribed values are made at the rate; all others are made when they are read.
Rule 2: each interval reaches each subscriber, in order, also when this process was late: the feed keeps the bins.
Rule 3: a status is judged at the moment of reading or sending, never stored.  After an outage it is good again with the
        first complete interval, not with the first sample.  Until then the value is the one from before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any

from asyncua import ua

from gateway.views.board_feed import BoardFeed
from gateway.views.decimate import Bin, TopicBins
from gateway.views.opcua.address_space import quality
from gateway.views.opcua.address_space.extras import EXTRAS, Extra, extra_value
from gateway.views.opcua.address_space.history import RingHistory, Track
from gateway.views.opcua.address_space.model import TICK_TOPICS, TOPICS, Leaf, leaves
from gateway.views.opcua.address_space.parameters import instrument_ranges, nameplate, ranges
from gateway.views.opcua.address_space.values import StampClock, Value, data_value, datetime_of, notify
from gateway.views.opcua.operations import SETPOINTS
from gateway.views.opcua.sessions import GuardedServer
from gateway.views.opcua.types import MACHINES, RIG_TYPE, VALUE, Builder, instantiate
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics

_V = ua.VariantType


class BoardNodes:
    """The nodes of one board below `parent`, with `rate_hz` intervals per second and `history_s` of them kept."""

    def __init__(
        self,
        server: GuardedServer,
        builder: Builder,
        parent: ua.NodeId,
        feed: BoardFeed,
        *,
        rate_hz: float,
        history: RingHistory,
        history_s: float,
    ) -> None:
        self.feed = feed
        self.name = feed.name
        self._server, self._builder = server, builder
        self._clock = StampClock()
        self._taps: dict[str, TopicBins] = {
            topic: feed.tap(topics.TOPIC_OF_NAME[topic].message, width_s=1.0 / rate_hz) for topic in TICK_TOPICS
        }
        self._bins: dict[str, Bin] = {}
        self._outlived: set[str] = set()  # topics whose bin is from before an outage
        self._stamps_ns: dict[str, int] = {}
        self._sent: dict[str, tuple[object, int]] = {}  # sent last: message, status; the id of a message may come again
        # The attribute of each variable is asyncua's AttributeValue: its datachange_callbacks are the subscribers.
        self._nodes: dict[str, list[tuple[Leaf, Any]]] = {topic: [] for topic in TOPICS}
        self._extras: list[tuple[Extra, Any]] = []
        self._sent_extras: dict[str, object] = {}  # by path: value sent last, and to whom
        self._tracks: dict[str, Track] = {}
        self._parameters: pb.Parameters | None = None  # those whose ranges and nameplate are shown
        rig = ua.NodeId(RIG_TYPE, builder.spaces.types)
        self.object = builder.object(parent, self.name, "one rig", kind=rig, events=True)
        builder.refer(ua.NodeId(MACHINES, builder.spaces.machinery), ua.ObjectIds.Organizes, self.object)
        builder.refer(ua.NodeId(ua.ObjectIds.Server), ua.ObjectIds.HasNotifier, self.object)
        instantiate(server.aspace, rig, self.object, interval_ms=1000.0 / rate_hz)
        self._attach(history, max(2, round(history_s * rate_hz)))

    def _attach(self, history: RingHistory, rows: int) -> None:
        """Give the variables their values and their history."""
        for topic in TOPICS:
            topic_leaves = [leaf for leaf in leaves() if leaf.topic == topic]
            columns = [leaf for leaf in topic_leaves if leaf.statistic is not None]
            track = self._tracks[topic] = Track(len(columns), rows) if columns else Track(0, 1)
            for leaf in topic_leaves:
                if leaf.statistic is not None:
                    history.add(self._id(leaf.path), track, columns.index(leaf))
                self._nodes[topic].append((leaf, self._serve(leaf.path, partial(self._value, leaf))))
                if topic in TICK_TOPICS and leaf.statistic in (None, "last"):
                    self._server.subscription_service.periodic.add(self._id(leaf.path))
        self._extras = [(extra, self._serve(extra.path, partial(extra_value, self.feed, extra))) for extra in EXTRAS]
        for field in SETPOINTS:
            path = f"setpoint/{field}"
            leaf = next(leaf for leaf in leaves() if leaf.path == f"state/{field}")
            self._nodes["state"].append((leaf, self._serve(path, partial(self._value, leaf))))
            self._server.subscription_service.periodic.add(self._id(path))

    def _id(self, path: str) -> ua.NodeId:
        return self._builder.id(f"{self.name}/{path}")

    def _serve(self, path: str, read: Callable[[], Value]) -> Any:
        self._server.set_attribute_value_callback(self._id(path), lambda _node, _attribute: read())
        return self._server.aspace[self._id(path)].attributes[VALUE]

    # -- reading

    def _value(self, leaf: Leaf, status: int | None = None) -> Value:
        """Return the value of a leaf with the status of its topic, which is the present one by default."""
        status = self._status(leaf.topic) if status is None else status
        read = self._value_of_message if leaf.statistic is None else self._value_of_bin
        return read(leaf, self._bins.get(leaf.topic), status)

    def _status(self, topic: str) -> int:
        """Return the present status of all values of a topic."""
        status = self._source_status(topic)
        return quality.STALE if topic in self._outlived and not quality.is_down(status) else status

    def _source_status(self, topic: str) -> int:
        feed = self.feed
        message = topics.TOPIC_OF_NAME[topic].message
        if feed.latest(message) is None:
            return quality.WAITING
        if topic == "state":
            return quality.of_board(feed.link())
        if topic.startswith("twin/"):
            twin = feed.latest(pb.TwinState)
            if twin is None:
                return quality.WAITING
            return quality.of_twin(feed.age_s(pb.TwinState), twin.sync if topic != "twin/model" else "in-step")
        link, age_s = feed.link(), feed.age_s(pb.Status)
        if topic == "parameters" and link.state in ("absent", "no-gateway"):
            return quality.STALE
        return quality.of_gateway(link, age_s)

    def _value_of_bin(self, leaf: Leaf, bin_: Bin | None, status: int) -> Value:
        if bin_ is None:
            return data_value(None, leaf.variant, quality.WAITING if not quality.is_bad(status) else status, 0)
        return data_value(
            _number(leaf, bin_), leaf.variant, self._status_of(leaf, bin_, status), self._stamps_ns[leaf.topic]
        )

    def _status_of(self, leaf: Leaf, bin_: Bin, status: int) -> int:
        if isinstance(bin_.message, pb.State):
            status = quality.of_signal(status, leaf, bin_.message.flags, fault=self.feed.fault())
        return quality.of_extreme(status, leaf.statistic, bin_.lost)

    def _value_of_message(self, leaf: Leaf, bin_: Bin | None, status: int) -> Value:
        # The message of the numbers that were shown with it, not a newer one.
        message: Any = self.feed.latest(leaf.message) if bin_ is None else bin_.message
        if message is None:
            return data_value(None, leaf.variant, quality.WAITING, 0)
        value: Any = attrgetter(leaf.field)(message)
        if leaf.is_array:
            value = [f"{k}={v}" for k, v in value.items()] if leaf.variant is _V.String else list(value)
        if leaf.topic == "state":
            status = quality.of_signal(status, leaf, message.flags, fault=self.feed.fault())
            value = None if _is_absent(message, leaf.field) else value
        elif leaf.topic == "plant" and _is_absent(message, leaf.field):
            status = quality.UNAVAILABLE if not quality.is_bad(status) else status
        stamp_ns = getattr(message, "host_time_ns", 0) if bin_ is None else self._stamps_ns[leaf.topic]
        return data_value(value, leaf.variant, status, stamp_ns)

    # -- updating

    async def update(self) -> None:
        """Send the changes since the last call to their subscribers, and append to the history."""
        await self._update_parameters()
        for topic in TICK_TOPICS:
            down = quality.is_down(self._source_status(topic))
            bins = self._taps[topic].take(unfinished=down)
            if down:
                self._outlived.add(topic)
            elif bins:
                self._outlived.discard(topic)
            status = self._status(topic)
            for bin_ in bins:
                await self._interval(topic, bin_, status)
                # Many have gathered where this process was held up: clients are answered meanwhile.
                await asyncio.sleep(0)
            if not bins and topic in self._bins and self._sent.get(topic, (None, status))[1] != status:
                await self._interval(topic, self._bins[topic], status, again=True)  # its status has changed
            self._sent[topic] = (None, status)
        for topic in TOPICS[len(TICK_TOPICS) :]:
            message, status = self.feed.latest(topics.TOPIC_OF_NAME[topic].message), self._status(topic)
            before = self._sent.get(topic)
            if before is None or before[0] is not message or before[1] != status:
                self._sent[topic] = (message, status)
                for leaf, attribute in self._nodes[topic]:
                    if attribute.datachange_callbacks:
                        await notify(attribute, self._value(leaf, status))
        await self._update_extras()

    async def _interval(self, topic: str, bin_: Bin, status: int, *, again: bool = False) -> None:
        self._bins[topic] = bin_
        if not again:
            self._stamps_ns[topic] = self._stamp(topic, bin_)
        values, codes = list[float](), list[int]()
        for leaf, attribute in self._nodes[topic]:
            if leaf.statistic is not None and len(values) < self._tracks[topic].columns:
                values.append(value := _number(leaf, bin_))
                code = self._status_of(leaf, bin_, status)
                codes.append(quality.UNAVAILABLE if value != value and not quality.is_bad(code) else code)
            if attribute.datachange_callbacks:
                await notify(attribute, self._value(leaf, status))
        stamp_ns = self._stamps_ns[topic] + (1000 if again else 0)
        self._tracks[topic].append(stamp_ns, values, codes)

    def _stamp(self, topic: str, bin_: Bin) -> int:
        last = bin_.message
        if topic == "state":
            return self._clock.stamp(session=last.session, t_s=last.t_s, host_time_ns=last.host_time_ns)
        return max(self._clock.time_ns(last.t_s), self._stamps_ns.get(topic, 0) + 1000)

    async def _update_extras(self) -> None:
        for extra, attribute in self._extras:
            if attribute.datachange_callbacks:
                # A new subscriber may have begun with a value that came and went since the last call.
                value = extra.read(self.feed), tuple(attribute.datachange_callbacks)
                if self._sent_extras.get(extra.path) != value:
                    self._sent_extras[extra.path] = value
                    await notify(attribute, attribute.value_callback(None, VALUE))

    async def _update_parameters(self) -> None:
        """Update ranges and nameplate if the board has sent new parameters."""
        parameters = self.feed.latest(pb.Parameters)
        if parameters is None or parameters is self._parameters:
            return
        self._parameters = parameters
        stamp = datetime_of(parameters.host_time_ns) if parameters.host_time_ns else None
        for name, spans in (("EURange", ranges(parameters)), ("InstrumentRange", instrument_ranges(parameters))):
            for path, (low, high) in spans.items():
                span = ua.Variant(ua.Range(Low=low, High=high), _V.ExtensionObject)
                await self._hold(f"{path}/{name}", Value(Value=span, SourceTimestamp=stamp))
        for name, text in nameplate(parameters).items():
            await self._hold(f"Identification/{name}", Value(Value=text, SourceTimestamp=stamp))

    async def _hold(self, path: str, value: Value) -> None:
        attribute = self._server.aspace[self._id(path)].attributes[VALUE]
        if attribute.value.Value != value.Value:
            attribute.value = value
            await notify(attribute, value)


def _number(leaf: Leaf, bin_: Bin) -> float:
    """Return the lowest, highest or last value of a bin."""
    numbers: dict[str, float] = getattr(bin_, leaf.statistic or "last")
    return numbers[leaf.field]


def _is_absent(message: Any, field: str) -> bool:
    first, _, rest = field.partition(".")
    if message.DESCRIPTOR.fields_by_name[first].has_presence and not message.HasField(first):
        return True
    return bool(rest) and _is_absent(getattr(message, first), rest)
