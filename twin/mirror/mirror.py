"""Turn State and Parameters of one board into twin state, divergence and alarms.  No clock, no I/O, no threads.

`Mirror.handle` is the only entry, for a live board, a log and tests: the same messages in the same order give the same
bits.

Rule 1: the board's tick is the only time.  What happened between two known ticks is either simulated and counted
        (`bridged_ticks`) or not compared at all.
Rule 2: at most `bridge_ticks_max` lost samples are bridged, and only if x_ref, mode and parameters are equal on both
        sides.  If u_c drives the twin, u_c must be equal, too.  Otherwise the twin is out of step: it starts again from
        the measurement with empty windows and settles.
Rule 3: a change of mode between two consecutive samples is not a loss.  The twin starts as the board does (rule 6 of
        protocol/README.md) and settles, without an alarm.
Rule 4: without the board's parameters there is no law, hence no free twin; the observer runs all the same.
Rule 5: a new model is a new twin: it starts with the next sample and settles, and the alarms of the old one end.
Rule 6: an alarm on the comparison concerns one flight.  A new session or a silence of more than SILENT_S ends it at
        once, and a change of mode ends those on errors.  Other interruptions of the evidence end it after a while
        (rule 4 of twin/mirror/monitor/divergence.py).  New evidence raises it again.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import is_plausible
from twin.compiled import Packed
from twin.mirror.loop import advance
from twin.mirror.monitor.divergence import Comparison
from twin.mirror.output import IN_STEP, OUT_OF_STEP, SETTLING, Output
from twin.mirror.regime import KnownParameters, Regime
from twin.mirror.sample import Sample, interruption, read, sample_time_between
from twin.mirror.step import step
from twin.model.extended import WARMTH
from twin.model.parameters import Model
from twin.model.simulate import INTEGRAL, X_BEFORE, X_READ, places, rig_at
from twin.settings.mirror import SAMPLE_TIME_RANGE_S, SILENT_S, Settings

_SAMPLES_IN = {sync: f"samples_{sync}" for sync in (IN_STEP, SETTLING, OUT_OF_STEP)}
_LOSS_TEXTS = {
    "board-reset": "the board was reset or reconnected",
    "time-backwards": "the tick went backwards within a session",
    "parameters-changed": "gains, operating point or scalings of the board changed",
    "lost-samples": "too many samples were lost, or mode, x_ref or input changed among the lost ones",
    "missing-channel": "a sample lacks x_ref (closed loop) or u_c (open loop)",
    "unsupported-sample-time": f"T_s is outside {SAMPLE_TIME_RANGE_S[0]:g} .. {SAMPLE_TIME_RANGE_S[1]:g} s",
}


class Mirror:
    """A board and its twin.

    Args:
        model: what the twin believes.
        settings: window, false-alarm rate, longest bridge.

    `counters` counts everything out of the ordinary by name, for a summary and for tests.
    """

    def __init__(self, model: Model, settings: Settings | None = None) -> None:
        self.model = model
        self.settings = settings or Settings()
        self.counters: Counter[str] = Counter()
        self.sync = OUT_OF_STEP
        self._known = KnownParameters()
        self.regime: Regime | None = None  # of the last sample; None where T_s is not known or not supported
        self.comparison = Comparison()
        self._packed: Packed | None = None  # tuple(Twin)
        self._twin = np.zeros(0)  # memory of `advance`, made with the regime
        self._flying = False  # whether there is a free twin in it
        self._last: Sample | None = None
        self._settling_ticks = 0
        self._alarm_active = False  # out-of-step

    def parameters(self, parameters: pb.Parameters) -> None:
        """Take the parameters of the board; repetitions have no effect, and neither have numbers of no rig."""
        # A law with numbers of no rig would call every sample wrong.
        if not is_plausible(parameters):
            self.counters["implausible_parameters"] += 1
            return
        new, last = self._known.add(parameters), self._last
        if new and last is not None and last.session == parameters.session and parameters.from_tick <= last.tick:
            if not self._known.first(last.session):
                # Samples since from_tick were compared under the old ones.  They cannot be called back: count them.
                self.counters["samples_under_old_parameters"] += last.tick - parameters.from_tick + 1

    def handle(self, state: pb.State) -> Output | None:
        """Compare one sample; None if it repeats the previous tick."""
        self.counters["samples"] += 1
        now, last = read(state, self.counters), self._last
        same = last is not None and last.session == now.session
        if last is not None and same and last.tick == now.tick:
            self.counters["duplicates"] += 1
            return None
        self._last = now
        alarms: list[pb.Alarm] = []
        loss, bridged = self._enter_regime(now, last), 0
        consecutive = last is not None and same and now.tick == last.tick + 1 and not loss
        # One test for all that is out of the ordinary: the other samples, 500 a second, take the short way.
        if not consecutive or not self._flying or last is None or last.mode != now.mode or math.isnan(now.drive):
            loss, bridged = self._out_of_the_ordinary(now, last, loss, alarms)
            consecutive = consecutive and not loss
        sync = self._decide_sync(loss, bridged, alarms)

        answer = None
        flying, regime, packed = self._flying, self.regime, self._packed
        if regime is not None and packed is not None:
            answer = step(
                packed,
                regime.yardstick(now.x_ref) if flying and now.closed_loop else regime.sensors_yardstick,
                # A plain tuple in the order of `Tick`, which would take longer to make: this runs 500 times a second.
                (
                    now.i,
                    now.x,
                    now.u,
                    now.x_ref,
                    now.closed_loop,
                    consecutive,
                    now.usable,
                    now.mode == pb.MODE_IDLE and last is not None and last.mode != pb.MODE_IDLE,
                    flying,
                    sync == IN_STEP,
                ),
            )
            (_, _, _, _, valid), _, _, _, _, changed, changes = answer
            if valid:
                self.counters["innovations"] += 1
            if changed:
                alarms += self.comparison.messages(changes)
        else:
            alarms += self.comparison.skip()
        for alarm in alarms:
            alarm.host_time_ns, alarm.tick, alarm.session = state.host_time_ns, state.tick, state.session
        return Output(now, sync, bridged, flying, answer, tuple(alarms), 0.0 if regime is None else regime.nis_on)

    def use(self, model: Model) -> list[pb.Alarm]:
        """Use `model` from the next sample on; returns the alarms that end with the previous model.

        An error leaves the mirror unchanged.

        Raises:
            ValueError, ArithmeticError, numpy.linalg.LinAlgError: no twin can be made of these numbers.
        """
        regime = self.regime
        # Made before anything is changed: numbers of which no twin can be made raise here.
        if regime is not None:
            regime = Regime(model, self.settings, sample_time_s=regime.sample_time_s, parameters=regime.parameters)
        self.model, self.regime = model, regime
        alarms = self.comparison.forget("another model is used from now on")
        if regime is not None:
            self._packed = self._hold(regime)
        self._stop()
        self.counters["models"] += 1
        return self._stamped(alarms)

    def silence(self, text: str) -> list[pb.Alarm]:
        """Report that no samples arrive, as seen by the caller's clock; this affects alarms only."""
        self.counters["silences"] += 1
        alarms = self.comparison.drop_alarms(text)
        if not self._alarm_active:
            self._alarm_active = True
            alarms.append(pb.Alarm(name=OUT_OF_STEP, active=True, value=self._losses(), text=text))
        return self._stamped(alarms)

    def _stamped(self, alarms: list[pb.Alarm]) -> list[pb.Alarm]:
        if self._last is not None:
            for alarm in alarms:
                alarm.tick, alarm.session = self._last.tick, self._last.session
        return alarms

    # ---- what kind of sample is this

    def _out_of_the_ordinary(
        self, now: Sample, last: Sample | None, loss: str, alarms: list[pb.Alarm]
    ) -> tuple[str, int]:
        """Handle a sample that does not continue the flight; returns (why the twin loses step or '', ticks bridged)."""
        bridged = 0
        if not loss and last is not None:
            loss = interruption(now, last, self.settings.bridge_ticks_max)
        if last is not None and (now.session != last.session or now.t_s - last.t_s > SILENT_S):
            alarms += self.comparison.drop_alarms("")
        elif last is not None and last.mode != now.mode:
            alarms += self.comparison.drop_error_alarms()
        if loss:
            self._lose_step(loss, alarms)
        elif last is not None and last.mode != now.mode:
            self.counters["mode_changes"] += 1
            self._stop()
        elif last is not None and self._flying:
            bridged = self._bridge_lost(last, now.tick - last.tick - 1)
        if not self._flying:
            consecutive = last is not None and last.session == now.session and now.tick == last.tick + 1 and not loss
            self._start(now, last if consecutive else None)
        return loss, bridged

    def _enter_regime(self, now: Sample, last: Sample | None) -> str:
        """Prepare the regime for this sample's T_s and parameters; returns why the twin loses step by that, or ''."""
        parameters = self._known.at(now.session, now.tick)
        regime = self.regime
        # The same object at nearly every sample: messages are compared field by field only where it is another.
        if regime is not None and parameters is regime.parameters and parameters is not None:
            return ""
        same = last is not None and last.session == now.session
        if parameters is not None:
            # As the board states it; from the times of two samples it is known to 0.1 us only.
            sample_time_s = parameters.sample_time_s
        elif regime is not None and regime.parameters is None and same:
            return ""
        else:
            sample_time_s = sample_time_between(last, now)
        low, high = SAMPLE_TIME_RANGE_S
        known = low <= sample_time_s <= high
        if regime is not None and known and parameters == regime.parameters and sample_time_s == regime.sample_time_s:
            regime.parameters = parameters  # the next session's, equal in all that matters
            return ""
        self.regime = None
        if not known:
            unknown = "" if regime is None else "parameters-changed"
            return "unsupported-sample-time" if math.isfinite(sample_time_s) else unknown
        self.regime = regime = Regime(self.model, self.settings, sample_time_s=sample_time_s, parameters=parameters)
        self._packed = self._hold(regime)
        return "parameters-changed" if same else ""

    def _hold(self, regime: Regime) -> Packed:
        """Clear all windows and pack what stays constant during the regime."""
        self.comparison.start(regime.window, regime.hold)
        # Not a number until the first start: `_start` sees by it that nobody knows how warm the coil is.
        self._twin = np.full(places(regime.plant), math.nan)
        return regime.packed(self.comparison.windows, self._twin)

    # ---- in step or not

    def _losses(self) -> int:
        return sum(count for name, count in self.counters.items() if name.startswith("out_of_step:"))

    def _lose_step(self, why: str, alarms: list[pb.Alarm]) -> None:
        was = self._flying
        self._stop()
        if not was:
            return
        self.counters[f"out_of_step:{why}"] += 1
        if not self._alarm_active:
            self._alarm_active = True
            alarms.append(pb.Alarm(name=OUT_OF_STEP, active=True, value=self._losses(), text=_LOSS_TEXTS[why]))

    def _stop(self) -> None:
        self._flying = False
        self.comparison.interrupt()

    def _bridge_lost(self, last: Sample, missing: int) -> int:
        regime = self.regime
        if regime is None or missing == 0:
            return 0
        # Simulated, not set to the measurement, which would hide the slow divergence that the free twin is to show.
        for _ in range(missing):
            advance(regime.packed_plant, regime.packed_law, self._twin, last.closed_loop, last.x_ref, last.u)
        self.counters["bridges"] += 1
        self.counters["bridged_ticks"] += missing
        return missing

    def _start(self, now: Sample, before: Sample | None) -> None:
        """Start from the measurement if it is complete; `before` is the sample one tick earlier, if there is one."""
        regime = self.regime
        if regime is None or regime.law is None or not math.isfinite(now.i + now.x) or math.isnan(now.drive):
            return
        if (memory := regime.memory_at(now, before)) is None:
            return
        v, s, x_prev = memory
        # The input so far is that of the sample before: u_c of a sample acts from its tick on.
        u = before.u if before is not None and math.isfinite(before.u) else now.u
        warmth = float(self._twin[WARMTH])  # a coil stays as warm as it was; one that nobody saw is warm from this i_c
        self._twin[:] = rig_at(
            regime.plant,
            i=now.i,
            x=now.x,
            v=v,
            u=u if math.isfinite(u) else 0.0,
            warmth=warmth if math.isfinite(warmth) else None,
        )
        self._twin[INTEGRAL] = s
        self._twin[X_BEFORE] = self._twin[X_READ] if math.isnan(x_prev) else x_prev
        self._flying = True
        self._settling_ticks = regime.settle_ticks(closed_loop=now.closed_loop, x_ref=now.x_ref)
        self.counters["starts"] += 1

    def _decide_sync(self, loss: str, bridged: int, alarms: list[pb.Alarm]) -> str:
        if not self._flying or loss:
            self.sync = OUT_OF_STEP
        elif self._settling_ticks > 0:
            self.sync = SETTLING
            self._settling_ticks -= 1 + bridged
        else:
            self.sync = IN_STEP
        self.counters[_SAMPLES_IN[self.sync]] += 1
        # In step, not when settling begins: a loop that loses step again and again would raise it each time.
        if self.sync == IN_STEP and self._alarm_active:
            self._alarm_active = False
            alarms.append(pb.Alarm(name=OUT_OF_STEP, active=False, value=self._losses(), text="in step again"))
        return self.sync
