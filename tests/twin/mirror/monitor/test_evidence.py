"""An alarm lives on evidence in the samples: when twin and rig are not compared any longer, it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from protocol.bus import board51_pb2 as pb
from protocol.bus.topics import key
from tests.harness.ports import free_endpoint
from tests.harness.twin.rig import T_S, Rig
from tests.harness.twin.twin_bus import Subscriber, introduce, publish, router, wait_for_count
from tests.twin.mirror.bus.test_handover import alarms as alarms_on_bus
from tests.twin.mirror.bus.test_handover import divergences, offset_rig
from twin.mirror.bus.request import NAME
from twin.mirror.bus.service import TwinService
from twin.mirror.mirror import Mirror
from twin.mirror.offline import run_log
from twin.mirror.output import IN_STEP, OUT_OF_STEP, Output
from twin.model.parameters import Model
from twin.readers.log import TwinLog
from twin.settings.mirror import Settings

HELD = 2.85e-3
EXPECTED = ("innovation", "divergence-i_c")  # the integrator takes the ball to x_ref, so x is right all the same
HOLD_TICKS = round((1.0 + 5.0) / T_S)  # a window and the longest settling


class Run:
    """A mirror, and which of its alarms are active."""

    def __init__(self) -> None:
        self.mirror = Mirror(Model.load("ce152"))
        self.active: dict[str, pb.Alarm] = {}
        self.changes: list[tuple[str, bool]] = []
        self.last: Output | None = None

    def feed(self, states: Iterable[pb.State]) -> None:
        for state in states:
            output = self.mirror.handle(state)
            if output is not None:
                self.last = output
                self.take(output.alarms)

    def take(self, alarms: Iterable[pb.Alarm]) -> None:
        for alarm in alarms:
            self.changes.append((alarm.name, alarm.active))
            if alarm.active:
                self.active[alarm.name] = alarm
            else:
                assert self.active.pop(alarm.name, None) is not None, f"{alarm.name} ended twice"

    def of(self, names: Iterable[str]) -> list[str]:
        return [name for name in names if name in self.active]


def alarmed() -> tuple[Rig, Run]:
    """Return a rig that the model does not describe, and a run in step with it."""
    rig, run = offset_rig(), Run()
    run.mirror.parameters(rig.parameters())
    run.feed(rig.run(1500, HELD))
    assert run.of(EXPECTED) == list(EXPECTED)
    run.changes.clear()
    return rig, run


def idle(rig: Rig, *, session: int, lost: int = 0) -> None:
    rig.session = session
    rig.tick += lost
    rig.set_mode(pb.MODE_IDLE)


@pytest.mark.parametrize(("session", "lost"), [(2, 1500), (2, 0), (1, 400)], ids=["restarted", "session", "lost"])
def test_a_flight_that_ended_unseen_leaves_no_alarm_over_an_idle_rig(session: int, lost: int) -> None:
    rig, run = alarmed()

    idle(rig, session=session, lost=lost)
    run.mirror.parameters(rig.parameters())
    run.feed(rig.run(1, HELD))
    at_once = run.of(("divergence-i_c",))
    run.feed(rig.run(3000, HELD))

    assert at_once == []
    assert run.active == {}
    assert run.last is not None
    assert run.last.sync == IN_STEP


def test_a_new_session_without_parameters_ends_what_needs_them() -> None:
    """The observer runs without the board's parameters: what the innovations say, they say on new evidence."""
    rig, run = alarmed()

    rig.session = 2
    run.feed(rig.run(600, HELD))

    assert set(run.active) == {OUT_OF_STEP, "innovation"}
    assert run.active["innovation"].session == 2


def lose_the_sensor(state: pb.State) -> None:
    state.i_c_a = float("nan")


def lose_the_reference(state: pb.State) -> None:
    state.ClearField("x_ref_m")


@pytest.mark.parametrize("damage", [lose_the_sensor, lose_the_reference])
def test_an_alarm_that_no_sample_judges_ends_after_a_while(damage: Callable[[pb.State], None]) -> None:
    rig, run = alarmed()
    states = list(rig.run(HOLD_TICKS + 2, HELD))
    for state in states:
        damage(state)

    run.feed(states[: HOLD_TICKS - 2])
    before = run.of(("divergence-i_c",))
    run.feed(states[HOLD_TICKS - 2 :])

    assert before == ["divergence-i_c"]
    assert run.of(("divergence-i_c",)) == []


def test_parameters_that_nothing_can_be_compared_under_end_it_too() -> None:
    rig, run = alarmed()
    strange = rig.parameters(from_tick=rig.tick)
    strange.sample_time_s = 1.0

    run.mirror.parameters(strange)
    run.feed(rig.run(HOLD_TICKS + 1, HELD))

    assert list(run.active) == [OUT_OF_STEP]


def test_a_short_loss_in_flight_neither_ends_nor_repeats_it() -> None:
    rig, run = alarmed()

    list(rig.run(100, HELD))
    run.feed(rig.run(3000, HELD))

    assert run.of(EXPECTED) == list(EXPECTED)
    assert [change for change in run.changes if change[0] in EXPECTED] == []


def test_after_a_long_gap_only_new_evidence_raises_it() -> None:
    rig, run = alarmed()

    list(rig.run(600, HELD))
    run.feed(rig.run(1, HELD))
    at_once = run.of(EXPECTED)
    run.feed(rig.run(3000, HELD))

    assert at_once == []
    assert run.of(EXPECTED) == list(EXPECTED)


def test_silence_ends_it() -> None:
    _, run = alarmed()

    run.take(run.mirror.silence("no sample for 1 s"))

    assert list(run.active) == [OUT_OF_STEP]


def test_over_a_log_the_alarms_are_those_of_the_live_twin(tmp_path: Path) -> None:
    rig = offset_rig()
    messages: list[pb.Parameters | pb.State] = [rig.parameters(), *rig.run(1500, HELD)]
    idle(rig, session=2, lost=1500)
    messages += [rig.parameters(), *rig.run(1500, HELD)]
    live = Run()
    with TwinLog(tmp_path / "flight.mcap") as log:
        for n, message in enumerate(messages):
            topic = "state" if isinstance(message, pb.State) else "parameters"
            log.write(
                key("lab", "rig", topic),
                message.SerializeToString(),
                message_type=type(message),
                log_time_ns=10**18 + n,
            )
            if isinstance(message, pb.State):
                live.feed([message])
            else:
                live.mirror.parameters(message)

    (run,), _ = run_log(tmp_path / "flight.mcap", Model.load("ce152"))

    assert [(alarm.name, alarm.active) for alarm in run.alarms] == live.changes
    assert live.active == {}


def test_on_the_bus_a_restarted_gateway_leaves_no_alarm_and_asks_for_no_diagnosis() -> None:
    """The alarm is on, the rig is parked meanwhile; for longer than asks for a diagnosis nothing more is compared."""
    endpoint, rig = free_endpoint(), offset_rig()
    settings = Settings(window_s=0.25, diagnosis_after_s=2.0)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,), settings=settings) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(800, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 800, "divergence")
            was = set(service.boards["rig"].alarms)
            idle(rig, session=2, lost=1500)
            introduce(session, service, rig)
            publish(session, list(rig.run(2000, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 2800, "divergence")
            left = set(service.boards["rig"].alarms)

    assert {"divergence-i_c"} <= was
    assert left == set()
    assert NAME not in {alarm.name for alarm in alarms_on_bus(subscriber)}
