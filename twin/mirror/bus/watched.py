"""A board on the bus with its twin: publishes the mirror's output, its model and the active alarms.

Rule 1: used by the service's worker thread alone.
Rule 2: what is repeated bears the time at which it is sent.  So repetitions differ, and `board51 fill` sees which is
        missing.  It is the gateway's time: that of the newest sample, and what has passed since by this host's clock.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
import zenoh
from google.protobuf.message import Message

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics
from protocol.bus.endpoint import has_subscriber
from twin.mirror.bus.handover import Belief, refusal
from twin.mirror.bus.request import DiagnosisRequest
from twin.mirror.mirror import Mirror
from twin.mirror.output import Output
from twin.mirror.regime import Regime
from twin.model.parameters import Model
from twin.settings.mirror import SILENT_S, Settings
from twin.settings.naming import FORGOTTEN_S

REPEAT_S = 5.0  # as the gateway's parameters: a log part or a late subscriber need not wait longer
_TOPICS = ("twin/state", "twin/divergence", "twin/states", "twin/alarm", "twin/alarms", "twin/model", "twin/diagnosis")
_LAST_NS = (1 << 64) - 1  # the largest number that a message can hold: a sample may bear any time
log = logging.getLogger(__name__)


class Namer(Protocol):
    """Names the cause by which a rig in flight differs from the model of its twin (`twin/live/naming`)."""

    def take(self, state: pb.State, output: Output, regime: Regime | None) -> pb.TwinDiagnosis | None:
        """Take a sample; a diagnosis where there is a new one, with an empty `cause` where the last one has ended."""

    def use(self, model: Model) -> None:
        """Begin anew, under another model."""

    def forget(self) -> None:
        """Begin anew: the flight has ended."""


class Watched:
    """A board that was heard of.

    Args:
        session: open; publishers are declared on it.
        site: first chunk of the keys.
        board: second.
        belief: the model to begin with.
        settings: of the mirror.
        reach: options with which another command reaches this bus, each after a space.
        namers: names causes under a model; None: nobody does.
    """

    def __init__(
        self,
        session: zenoh.Session,
        site: str,
        board: str,
        belief: Belief,
        settings: Settings | None,
        *,
        reach: str = "",
        namers: Callable[[Model], Namer] | None = None,
    ) -> None:
        self.site, self.board = site, board
        self.belief = belief
        self.mirror = Mirror(belief.model, settings)
        self.samples = 0
        self.silent = False
        self.alarms: dict[str, pb.Alarm] = {}  # those that are active
        self._namer = namers(belief.model) if namers is not None else None
        self.diagnosis = pb.TwinDiagnosis()
        self._publishers = {
            topic: session.declare_publisher(
                topics.key(site, board, topic),
                encoding=encoding.zenoh_encoding(topics.TOPIC_OF_NAME[topic].message),
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            for topic in _TOPICS
        }
        self._request = DiagnosisRequest(
            after_s=self.mirror.settings.diagnosis_after_s,
            command=f"board51 diagnose --live 2 --board {board}"
            + (f" --site {site}" if site != topics.DEFAULT_SITE else "")
            + reach
            + " --out diagnosis",
        )
        self._batch = pb.TwinBatch()  # answers to the batch of samples in work
        self._newest: pb.State | None = None
        self._now_ns = 0  # of the gateway's clock; 0 before the first sample
        self._since: tuple[int, int] | None = None  # session and tick of the first sample under the belief
        self._sampled_s = 0.0  # both monotonic
        self._repeated_s = -math.inf

    def take(self, state: pb.State, now_s: float) -> Output | None:
        """Answer one sample."""
        self.samples += 1
        self._sampled_s, self.silent, self._newest, self._now_ns = now_s, False, state, state.host_time_ns
        if self._since is None:
            self._since = (state.session, state.tick)
            self._repeat(now_s)
        output = self.mirror.handle(state)
        if output is None:
            return None
        if output.state is not None:
            self._batch.states.append(output.state)
        self._batch.divergences.append(output.divergence)
        for alarm in output.alarms:
            if alarm.active and alarm.threshold_on:  # the model is in doubt, not the line
                alarm.text += f" under the model {self.belief.model.name}"
            self._alarm(alarm)
        if (request := self._request.sample(state, output.judges)) is not None:
            self._alarm(request)
        if self._namer is not None:
            diagnosis = self._namer.take(state, output, self.mirror.regime)
            if diagnosis is not None:
                self._diagnose(diagnosis)
        return output

    def send_batch(self) -> None:
        """Publish the answers since the last call together, and each by itself where somebody subscribes to that."""
        for topic, answers in (("twin/state", self._batch.states), ("twin/divergence", self._batch.divergences)):
            # Most subscribers take the batch: a message for each tick would wake up each of them 500 times a second.
            if has_subscriber(self._publishers[topic]):
                for answer in answers:
                    self._publish(topic, answer)
        self._publish("twin/states", self._batch)
        self._batch = pb.TwinBatch()

    def use(self, belief: Belief) -> pb.CommandReply:
        """Run on another model from the next sample on, or say why not."""
        try:
            alarms = self.mirror.use(belief.model)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            log.warning("board %s: model %s refused: %s", self.board, belief.title, error)
            text = f"No twin can be made of this model with this board's gains and T_s ({error})."
            return refusal("not-runnable", text, command_id=belief.command_id)
        # Only now: a model that was refused must leave the one before it in force.
        was, self.belief = self.belief, belief
        log.info("board %s: model %s instead of %s, from %r", self.board, belief.title, was.title, belief.who)
        for alarm in alarms:
            self._alarm(alarm)
        if self._namer is not None:
            self._namer.use(belief.model)
            self._diagnose(pb.TwinDiagnosis())
        newest = self._newest
        self._since = (newest.session, newest.tick + 1) if newest else None
        if self._since is not None:
            self._publish_model()
        return pb.CommandReply(
            id=belief.command_id,
            accepted=True,
            text=f"runs on {belief.title} instead of {was.title}",
            tick=self._since[1] if self._since else 0,
            attempts=1,
        )

    def look_at_the_clock(self, now_s: float) -> None:
        """Notice silence; repeat what late subscribers need."""
        if self._newest is not None and self._newest.host_time_ns:
            passed_ns = round((now_s - self._sampled_s) * 1e9)
            self._now_ns = min(self._newest.host_time_ns + passed_ns, _LAST_NS)
        if self.samples and not self.silent and now_s - self._sampled_s > SILENT_S:
            self.silent = True
            for alarm in self.mirror.silence(f"no sample for {SILENT_S:g} s"):
                self._alarm(alarm)
        # Not with the alarms: evidence outlasts a pause of the bus, and the samples before and after it add up.
        if self._namer is not None and self.diagnosis.cause and now_s - self._sampled_s > FORGOTTEN_S:
            self._namer.forget()
            self._diagnose(pb.TwinDiagnosis())
        if self._since is not None and now_s - self._repeated_s > REPEAT_S:
            self._repeat(now_s)

    def _repeat(self, now_s: float) -> None:
        self._repeated_s = now_s
        self._publish_model()
        self._publish("twin/alarms", pb.TwinAlarms(active=self.alarms.values(), host_time_ns=self._now_ns))
        if self._namer is not None:
            self.diagnosis.host_time_ns = self._now_ns
            self._publish("twin/diagnosis", self.diagnosis)

    def _publish_model(self) -> None:
        assert self._since is not None
        session, tick = self._since
        message = self.belief.message(session=session, since_tick=tick, host_time_ns=self._now_ns)
        self._publish("twin/model", message)

    def _diagnose(self, diagnosis: pb.TwinDiagnosis) -> None:
        if diagnosis.cause != self.diagnosis.cause:
            log.warning("board %s: %s", self.board, diagnosis.sentence or "no cause is named any longer")
        newest = self._newest
        if newest is not None and not diagnosis.host_time_ns:
            diagnosis.host_time_ns = self._now_ns
            diagnosis.session, diagnosis.tick = newest.session, newest.tick
        self.diagnosis = diagnosis
        self._publish("twin/diagnosis", diagnosis)

    def _alarm(self, alarm: pb.Alarm) -> None:
        if self._newest is not None and not alarm.host_time_ns:
            # Raised between two samples.  Logs go by the gateway's clock, and this may be another host.
            alarm.host_time_ns = self._newest.host_time_ns
        log.warning("board %s: alarm %s %s (%s)", self.board, alarm.name, "on" if alarm.active else "off", alarm.text)
        if alarm.active:
            self.alarms[alarm.name] = alarm
        else:
            self.alarms.pop(alarm.name, None)
        self._publish("twin/alarm", alarm)
        if (answered := self._request.take_alarm(alarm)) is not None:
            self._alarm(answered)

    def _publish(self, topic: str, message: Message) -> None:
        self._publishers[topic].put(message.SerializeToString())
