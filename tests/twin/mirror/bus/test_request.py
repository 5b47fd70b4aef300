"""`diagnosis-wanted`: asked for once per episode, after the time that was chosen, and taken back."""

from __future__ import annotations

import argparse

from protocol.bus import board51_pb2 as pb
from tests.harness.ports import free_endpoint
from tests.harness.twin.twin_bus import Subscriber, introduce, publish, router, wait_for_count
from tests.twin.mirror.bus.test_handover import alarms, command, divergences, offset_rig, query, right_model
from twin.commands import diagnose
from twin.mirror.bus.request import NAME, DiagnosisRequest
from twin.mirror.bus.service import TwinService
from twin.model.parameters import Model
from twin.settings.mirror import Settings

HELD = 2.85e-3


def alarm(name: str, *, active: bool) -> pb.Alarm:
    return pb.Alarm(name=name, active=active, text="back within the range of noise")


def feed_samples(request: DiagnosisRequest, from_s: float, to_s: float, *, has_evidence: bool = True) -> list[pb.Alarm]:
    results = [
        request.sample(pb.State(t_s=0.5 * k, tick=k), lambda _: has_evidence)
        for k in range(round(2 * from_s), round(2 * to_s))
    ]
    return [result for result in results if result is not None]


def test_it_is_asked_once_per_episode_and_after_the_whole_time() -> None:
    request = DiagnosisRequest(after_s=30.0, command="board51 diagnose --live 2")

    request.take_alarm(alarm("innovation", active=True))
    request.take_alarm(alarm("divergence-x", active=True))
    first = feed_samples(request, 10, 100)
    first_end = request.take_alarm(alarm("innovation", active=False))
    end = request.take_alarm(alarm("divergence-x", active=False))
    quiet = feed_samples(request, 100, 200)
    request.take_alarm(alarm("innovation", active=True))
    second = feed_samples(request, 200, 300)

    assert [(event.name, event.active, event.tick, event.value) for event in first] == [(NAME, True, 80, 30.0)]
    assert first[0].text.startswith("innovation, divergence-x for 30 s")
    assert "press Diagnose the last 2 minutes of flight, or use board51 diagnose --live 2" in first[0].text
    assert first_end is None
    assert end is not None
    assert (end.name, end.active) == (NAME, False)
    assert quiet == []
    assert [event.tick for event in second] == [460]


def test_alarms_that_come_and_go_and_a_lost_rig_ask_for_nothing() -> None:
    request = DiagnosisRequest(after_s=30.0, command="")

    for k in range(10):
        request.take_alarm(alarm("innovation", active=True))
        assert feed_samples(request, 20 * k, 20 * k + 19) == []
        assert request.take_alarm(alarm("innovation", active=False)) is None
    request.take_alarm(alarm("out-of-step", active=True))

    assert feed_samples(request, 300, 400) == []


def test_time_begins_anew_with_a_board_that_was_reset() -> None:
    request = DiagnosisRequest(after_s=30.0, command="")
    request.take_alarm(alarm("innovation", active=True))

    assert feed_samples(request, 1000, 1020) == []
    assert [event.tick for event in feed_samples(request, 0, 100)] == [60]


def test_time_without_evidence_does_not_count() -> None:
    request = DiagnosisRequest(after_s=30.0, command="")
    request.take_alarm(alarm("divergence-x", active=True))

    assert feed_samples(request, 10, 30) == []
    assert feed_samples(request, 30, 130, has_evidence=False) == []
    assert [event.tick for event in feed_samples(request, 130, 200)] == [2 * 140]  # 19.5 s and 10.5 s


def test_zero_means_never() -> None:
    request = DiagnosisRequest(after_s=0.0, command="")
    request.take_alarm(alarm("innovation", active=True))

    assert feed_samples(request, 0, 1000) == []


def test_on_the_bus_a_lasting_alarm_asks_and_the_right_model_takes_it_back() -> None:
    endpoint, rig = free_endpoint(), offset_rig()
    settings = Settings(window_s=0.25, diagnosis_after_s=1.0)
    with router(endpoint) as session:
        subscriber = Subscriber(session, "lab")
        with TwinService(Model.load("ce152"), site="lab", endpoints=(endpoint,), settings=settings) as service:
            introduce(session, service, rig)
            publish(session, list(rig.run(1500, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 1500, "divergence")
            before = [event for event in alarms(subscriber) if event.name == NAME]
            query(session, "lab/rig/twin/command", command(right_model()))
            publish(session, list(rig.run(1000, HELD)))
            wait_for_count(lambda: len(divergences(subscriber)), 2500, "divergence")
            after = [event for event in alarms(subscriber) if event.name == NAME][len(before) :]
    first = min(event.tick for event in alarms(subscriber) if event.active)

    (advice,) = before
    assert advice.active
    assert advice.tick == first + 500, "one second of 2 ms after the first alarm"
    assert "board51 diagnose --live 2 --board rig --site lab" in advice.text
    parser = argparse.ArgumentParser()
    diagnose.configure(parser)
    typed = parser.parse_args(advice.text.partition("board51 diagnose ")[2].split())
    assert (typed.board, typed.site, typed.connect) == ("rig", "lab", [endpoint]), "it reaches this bus as it stands"
    assert [event.active for event in after] == [False]
    assert "another model" in after[0].text
