"""State and Parameters of one board in; twin state, divergence and alarms out.  Pure: no clock, no I/O, no threads.

`Mirror.handle` is the only entry, live, from a log and in tests: the same messages in the same order, the same bits.

Rule 1: the board's tick is the only time.  What happened between two known ticks is either simulated, and said so
        (`bridged_ticks`), or not compared at all.
Rule 2: bridged are at most `bridge_ticks_max` lost samples, where x_ref, mode and parameters are equal on both sides
        (and u_c, where that drives the twin).  Everything else puts the twin out of step: it starts again from the
        measurement, its windows empty, and settles.
Rule 3: a change of mode between two consecutive samples is no loss: the twin starts as the board does (rule 6 of
        protocol/README.md) and settles, without an alarm.
Rule 4: without the board's parameters there is no law, hence no free twin; the observer runs all the same.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from protocol.bus import board51_pb2 as pb
from protocol.wire.messages import Flag
from twin.control import integral_behind
from twin.mirror.divergence import Comparison
from twin.mirror.loop import FreeTwin
from twin.mirror.observer import Observer
from twin.mirror.regime import KnownParameters, Regime
from twin.mirror.settings import Settings
from twin.model.parameters import Model

IN_STEP, SETTLING, OUT_OF_STEP = "in-step", "settling", "out-of-step"
SAMPLE_TIME_RANGE_S = (1e-4, 2e-2)  # T_s for which the steps of the kernels were checked
_SAMPLES_IN = {sync: f"samples_{sync}" for sync in (IN_STEP, SETTLING, OUT_OF_STEP)}
CLIPPED = int(Flag.POSITION_RANGE | Flag.CURRENT_RANGE)
_LOSS_TEXTS = {
    "board-reset": "the board was reset or reconnected",
    "time-backwards": "the tick went backwards within a session",
    "parameters-changed": "gains, operating point or scalings of the board changed",
    "lost-samples": "too many samples were lost, or mode, x_ref or input changed among the lost ones",
    "missing-channel": "a sample lacks x_ref (closed loop) or u_c (open loop)",
    "unsupported-sample-time": f"T_s is outside {SAMPLE_TIME_RANGE_S[0]:g} .. {SAMPLE_TIME_RANGE_S[1]:g} s",
}


class Output(NamedTuple):
    """What one sample gives; `state` is None where there is no free twin."""

    state: pb.TwinState | None
    divergence: pb.Divergence
    alarms: tuple[pb.Alarm, ...]


class _Sample(NamedTuple):
    """A State with NaN for what it lacks."""

    tick: int
    session: int
    t_s: float
    closed_loop: bool
    mode: int
    i: float
    x: float
    u: float
    x_ref: float
    clipped: bool


class Mirror:
    """One board and its twin.

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
        self._regime: Regime | None = None
        self._observer: Observer | None = None
        self.comparison = Comparison()
        self._twin: FreeTwin | None = None
        self._last: _Sample | None = None
        self._settling_ticks = 0
        self._alarm_active = False  # out-of-step

    def parameters(self, parameters: pb.Parameters) -> None:
        """Take what the board says about itself; repetitions change nothing."""
        new = self._known.add(parameters)
        last = self._last
        if new and last is not None and last.session == parameters.session and parameters.from_tick <= last.tick:
            if not self._known.first(last.session):
                # Samples since from_tick were compared under the old ones.  They cannot be called back: count them.
                self.counters["samples_under_old_parameters"] += last.tick - parameters.from_tick + 1

    def handle(self, state: pb.State) -> Output | None:
        """Take one sample; None for one that repeats the tick before it."""
        self.counters["samples"] += 1
        now, last = self._read(state), self._last
        same = last is not None and last.session == now.session
        if last is not None and same and last.tick == now.tick:
            self.counters["duplicates"] += 1
            return None
        self._last = now
        alarms: list[pb.Alarm] = []

        loss = self._enter_regime(now, last)
        missing = now.tick - last.tick - 1 if last is not None and same else 0
        if not loss and last is not None:
            loss = self._interruption(now, last, missing=missing)
        consecutive = last is not None and same and missing == 0 and not loss
        bridged = 0
        if loss:
            alarms += self._lose_step(loss)
        elif last is not None and last.mode != now.mode:
            self.counters["mode_changes"] += 1
            alarms += self.comparison.drop_error_alarms()
            self._stop()
        elif missing > 0 and self._twin is not None and last is not None:
            bridged = self._bridge(self._twin, last, missing)
        if self._twin is None:
            self._start(now, last if consecutive else None)
        alarms += self._decide_sync(loss, bridged)

        divergence = pb.Divergence(
            sequence=state.sequence,
            tick=state.tick,
            session=state.session,
            t_s=state.t_s,
            sync=self.sync,
            bridged_ticks=bridged,
        )
        alarms += self._observe(now, divergence, consecutive=consecutive)
        twin_state = None
        if self._twin is not None and self._regime is not None:
            twin_state, more = self._compare(self._twin, self._regime, now, state, divergence)
            alarms += more
        for alarm in alarms:
            alarm.host_time_ns, alarm.tick, alarm.session = state.host_time_ns, state.tick, state.session
        return Output(twin_state, divergence, tuple(alarms))

    def silence(self, text: str) -> pb.Alarm | None:
        """The caller, who has a clock, misses the board.  Raises the alarm only: the twin's numbers know no clock."""
        self.counters["silences"] += 1
        if self._alarm_active:
            return None
        self._alarm_active = True
        alarm = pb.Alarm(name=OUT_OF_STEP, active=True, value=self._losses(), text=text)
        if self._last is not None:
            alarm.tick, alarm.session = self._last.tick, self._last.session
        return alarm

    # ---- what kind of sample is this

    def _read(self, state: pb.State) -> _Sample:
        i, x, u, x_ref = state.i_c_a, state.x_m, state.u_c_v, state.x_ref_m
        if i == 0.0 or x == 0.0 or u == 0.0 or x_ref == 0.0:  # what an absent field reads as
            i = i if state.HasField("i_c_a") else math.nan
            x = x if state.HasField("x_m") else math.nan
            u = u if state.HasField("u_c_v") else math.nan
            x_ref = x_ref if state.HasField("x_ref_m") else math.nan
        if not math.isfinite(i + x + u + x_ref):
            i, x, u, x_ref = (self._finite(*one) for one in (("i_c", i), ("x", x), ("u_c", u), ("x_ref", x_ref)))
        mode = state.mode
        if mode == pb.MODE_IDLE and math.isnan(u):
            u = 0.0  # idle is: coil off
        return _Sample(
            state.tick,
            state.session,
            state.t_s,
            mode == pb.MODE_CLOSED_LOOP,
            mode,
            i,
            x,
            u,
            x_ref,
            bool(state.flags & CLIPPED),
        )

    def _finite(self, name: str, value: float) -> float:
        if math.isfinite(value):
            return value
        self.counters[f"missing_{name}"] += 1
        return math.nan

    def _enter_regime(self, now: _Sample, last: _Sample | None) -> str:
        """Have the numbers for this sample's T_s and parameters ready; returns why the twin loses step by it, or ''."""
        parameters = self._known.at(now.session, now.tick)
        regime = self._regime
        if regime is not None and parameters is regime.parameters and parameters is not None:
            return ""
        same = last is not None and last.session == now.session
        if parameters is not None:
            sample_time_s = parameters.sample_time_s
        elif regime is not None and regime.parameters is None and same:
            return ""
        elif last is not None and same and now.tick > last.tick:
            sample_time_s = round((now.t_s - last.t_s) / (now.tick - last.tick), 7)
        else:
            sample_time_s = math.nan
        low, high = SAMPLE_TIME_RANGE_S
        known = low <= sample_time_s <= high
        if regime is not None and known and parameters == regime.parameters and sample_time_s == regime.sample_time_s:
            regime.parameters = parameters  # the next session's, equal in all that matters
            return ""
        if regime is None and not known:
            return "unsupported-sample-time" if math.isfinite(sample_time_s) else ""
        self._observer = self._regime = None
        if not known:
            return "unsupported-sample-time" if math.isfinite(sample_time_s) else "parameters-changed"
        self._regime = regime = Regime(self.model, self.settings, sample_time_s=sample_time_s, parameters=parameters)
        self._observer = Observer(regime.plant, self.model.noise, i_lsb_a=regime.i_lsb_a, x_lsb_m=regime.x_lsb_m)
        self.comparison.start(regime.window)
        return "parameters-changed" if same else ""

    def _interruption(self, now: _Sample, last: _Sample, *, missing: int) -> str:
        if now.session != last.session:
            return "board-reset"
        if missing < 0:
            return "time-backwards"
        held = now.x_ref == last.x_ref if now.closed_loop else now.u == last.u
        if missing > self.settings.bridge_ticks_max or (missing > 0 and not (held and now.mode == last.mode)):
            return "lost-samples"
        if math.isnan(now.x_ref if now.closed_loop else now.u):
            return "missing-channel"
        return ""

    # ---- in step or not

    def _losses(self) -> int:
        return sum(count for name, count in self.counters.items() if name.startswith("out_of_step:"))

    def _lose_step(self, why: str) -> list[pb.Alarm]:
        was = self._twin is not None
        self._stop()
        if not was:
            return []
        self.counters[f"out_of_step:{why}"] += 1
        if self._alarm_active:
            return []
        self._alarm_active = True
        return [pb.Alarm(name=OUT_OF_STEP, active=True, value=self._losses(), text=_LOSS_TEXTS[why])]

    def _stop(self) -> None:
        self._twin = None
        self.comparison.interrupt()

    def _bridge(self, twin: FreeTwin, last: _Sample, missing: int) -> int:
        for _ in range(missing):
            if last.closed_loop:
                twin.follow(last.x_ref)
            else:
                twin.drive(last.u)
        self.counters["bridges"] += 1
        self.counters["bridged_ticks"] += missing
        return missing

    def _start(self, now: _Sample, before: _Sample | None) -> None:
        """Begin from the measurement, if it suffices; `before` is the sample one tick earlier, where there is one."""
        regime = self._regime
        if regime is None or regime.law is None or not math.isfinite(now.i + now.x):
            return
        if not math.isfinite(now.x_ref if now.closed_loop else now.u):
            return
        x = min(max(now.x, 0.0), regime.plant.travel_m)
        v, s, x_prev = 0.0, 0.0, x
        if before is not None and math.isfinite(before.x):
            v = (now.x - before.x) / regime.sample_time_s
        if now.closed_loop and before is not None and not before.closed_loop:
            v = 0.0  # as the board does: it enters closed loop with speed 0 and an empty integrator
        elif now.closed_loop:
            if before is None or not math.isfinite(before.x + now.u):
                return
            found = integral_behind(regime.law, i=now.i, x=now.x, x_prev=before.x, x_ref=now.x_ref, u=now.u)
            if found is None:
                return
            s, x_prev = found, before.x
        self._twin = FreeTwin(plant=tuple(regime.plant), law=tuple(regime.law), i=now.i, x=x, v=v, s=s, x_prev=x_prev)
        self._settling_ticks = regime.settle_ticks(closed_loop=now.closed_loop, x_ref=now.x_ref)
        self.counters["starts"] += 1

    def _decide_sync(self, loss: str, bridged: int) -> list[pb.Alarm]:
        if self._twin is None or loss:
            self.sync = OUT_OF_STEP
        elif self._settling_ticks > 0:
            self.sync = SETTLING
            self._settling_ticks -= 1 + bridged
        else:
            self.sync = IN_STEP
        self.counters[_SAMPLES_IN[self.sync]] += 1
        if self.sync == IN_STEP and self._alarm_active:
            self._alarm_active = False
            return [pb.Alarm(name=OUT_OF_STEP, active=False, value=self._losses(), text="in step again")]
        return []

    # ---- the two comparisons

    def _observe(self, now: _Sample, divergence: pb.Divergence, *, consecutive: bool) -> list[pb.Alarm]:
        n_i = n_x = nis = math.nan
        valid = False
        if self._observer is not None and self._regime is not None:
            if not consecutive:
                self._observer.forget()
            if now.clipped or not math.isfinite(now.i + now.x + now.u):
                self._observer.forget()
            else:
                n_i, n_x, nis, valid = self._observer.observe(now.i, now.x, now.u)
            alarm = self.comparison.innovation(divergence, self._regime, n_i=n_i, n_x=n_x, nis=nis, valid=valid)
            if valid:
                self.counters["innovations"] += 1
            return [alarm] if alarm else []
        divergence.innovation_i_c_a = divergence.innovation_x_m = divergence.nis = divergence.nis_mean = math.nan
        return []

    def _compare(
        self, twin: FreeTwin, regime: Regime, now: _Sample, state: pb.State, divergence: pb.Divergence
    ) -> tuple[pb.TwinState, list[pb.Alarm]]:
        i, x, v = twin.i, twin.x, twin.v
        if now.closed_loop:
            u = twin.follow(now.x_ref)
        else:
            u = now.u
            twin.drive(u)
        alarms = self.comparison.free(
            divergence,
            measured=(now.x, now.i, now.u),
            twin=(x, i, u),
            expected=regime.expectation(now.x_ref) if now.closed_loop else regime.sensors,
            in_step=self.sync == IN_STEP,
            judge=now.closed_loop,
        )
        twin_state = pb.TwinState(
            sequence=state.sequence,
            tick=state.tick,
            session=state.session,
            t_s=state.t_s,
            i_c_a=i,
            x_m=x,
            v_m_s=v,
            u_c_v=u,
            x_ref_m=now.x_ref,
            sync=self.sync,
            bridged_ticks=divergence.bridged_ticks,
        )
        return twin_state, alarms
