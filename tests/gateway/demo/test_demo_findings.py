"""Tests of the demo's statements about flights, from a log that is made here with errors known beforehand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gateway.demo.findings import NOTABLE_A, REST_SAMPLES, Flight, conclusion, gather, sentence, table
from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import Cause, Diagnosis

T_S = 2e-3
REFERENCES_M = (1.5e-3, 3.0e-3, 4.5e-3)
EACH = REST_SAMPLES + 100
SPAN_S = len(REFERENCES_M) * EACH * T_S
RIG_A = 0.6


class Log:
    """Writes flights one after another."""

    def __init__(self, path: Path) -> None:
        self.writer = LogWriter(path)
        self.tick = 0

    def write(self, topic: str, message: pb.State | pb.TwinState | pb.Divergence | pb.Alarm | pb.TwinModel) -> None:
        self.writer.write(f"board51/demo/{topic}", message.SerializeToString(), self.tick * 2_000_000)

    def fly(self, name: str, errors_a: tuple[float, ...], *, noise_m_s2: float, alarms: tuple[str, ...] = ()) -> Flight:
        """A flight over the references; the twin's current is off by `errors_a` at each, and wild before rest."""
        begin_s = self.tick * T_S
        model = json.dumps({"noise": {"process_a_m_s2": noise_m_s2}})
        self.write("twin/model", pb.TwinModel(session=1, since_tick=self.tick, name=name, model_json=model))
        for x_ref, error in zip(REFERENCES_M, errors_a, strict=True):
            for k in range(EACH):
                at_rest = k >= EACH - REST_SAMPLES
                self.write(
                    "state",
                    pb.State(
                        session=1, tick=self.tick, t_s=self.tick * T_S, i_c_a=RIG_A, x_m=x_ref, x_ref_m=x_ref,
                        mode=pb.MODE_CLOSED_LOOP,
                    ),
                )  # fmt: skip
                twin_a = RIG_A - error if at_rest else 5.0
                self.write("twin/state", pb.TwinState(session=1, tick=self.tick, i_c_a=twin_a, sync="in-step"))
                self.write(
                    "twin/divergence",
                    pb.Divergence(
                        session=1, tick=self.tick, innovation_valid=at_rest, innovation_x_m=-3e-5,
                        innovation_i_c_a=2e-3, nis=2.5,
                    ),
                )  # fmt: skip
                self.tick += 1
        for alarm in alarms:
            self.write("twin/alarm", pb.Alarm(session=1, tick=self.tick - 1, name=alarm, active=True))
            self.write("twin/alarm", pb.Alarm(session=1, tick=self.tick - 1, name=alarm, active=False))
        return Flight(name=name, from_t_s=begin_s, to_t_s=begin_s + SPAN_S)


@pytest.fixture
def log(tmp_path: Path) -> Log:
    return Log(tmp_path / "run.mcap")


def summarize(log: Log, *flights: Flight) -> tuple[str, str]:
    log.writer.close()
    gather(log.writer.path, list(flights))
    return table(flights), sentence(flights)


def test_the_errors_at_rest_of_both_flights_are_in_the_table(log: Log) -> None:
    before = log.fly("nominal", (0.05, 0.10, 0.20), noise_m_s2=0.02, alarms=("innovation", "divergence-i_c"))
    after = log.fly("identified", (-0.02, 0.0, 0.03), noise_m_s2=0.02)

    table_text, summary = summarize(log, before, after)

    rows = {line.split()[0]: line.split()[1:] for line in table_text.splitlines() if line.split()[0][0].isdigit()}
    assert rows == {
        "1.50": ["0.600", "0.550", "+0.050", "0.620", "-0.020"],
        "3.00": ["0.600", "0.500", "+0.100", "0.600", "+0.000"],
        "4.50": ["0.600", "0.400", "+0.200", "0.570", "+0.030"],
    }
    assert "30.0 um" in table_text
    assert table_text.splitlines()[-1].split() == ["alarms", "raised", "2", "0"]
    # rms of 50, 100, 200 is 132.3; of 20, 0, 30 is 20.8
    assert "current at rest: the identified model cuts it from 132 to 21 mA rms" in summary
    assert "Left over: -20 to +30 mA, rising with the height of the ball" in summary
    assert summary.endswith("the identified twin raises no alarm.")


def test_no_alarm_is_not_called_right_where_the_model_calls_more_noise(log: Log) -> None:
    before = log.fly("nominal", (0.05, 0.10, 0.20), noise_m_s2=0.02)
    after = log.fly("identified", (0.04, -0.04, 0.04), noise_m_s2=4.0)

    _, summary = summarize(log, before, after)

    assert "counting 4 m/s^2 of acceleration as noise" in summary
    assert "height" not in summary, "the error goes up and down"


def test_a_worse_model_is_said_to_be_worse(log: Log) -> None:
    before = log.fly("nominal", (0.05, 0.05, 0.05), noise_m_s2=0.02)
    after = log.fly("identified", (0.1, 0.1, 0.1), noise_m_s2=0.02, alarms=("divergence-i_c", "divergence-i_c"))

    _, summary = summarize(log, before, after)

    assert "raises it from 50 to 100 mA" in summary
    assert summary.endswith("the identified twin still raises divergence-i_c.")


def test_a_right_model_leaves_nothing_to_speak_of(log: Log) -> None:
    before = log.fly("nominal", (0.05, 0.10, 0.20), noise_m_s2=0.02)
    after = log.fly("identified", (1e-4, -2e-4, 0.9 * NOTABLE_A), noise_m_s2=0.02)

    _, summary = summarize(log, before, after)

    assert "The rest is below 5 mA" in summary


def test_a_flight_without_a_twin_is_said_so(log: Log) -> None:
    flown = log.fly("nominal", (0.05, 0.10, 0.20), noise_m_s2=0.02)
    empty_flight = Flight(name="identified", from_t_s=1e3, to_t_s=1e3 + 1.0)

    assert "nothing can be compared" in summarize(log, flown, empty_flight)[1]


def test_every_model_after_the_first_is_compared_with_the_one_before(log: Log) -> None:
    flights = [
        log.fly("nominal", (0.10, 0.10, 0.10), noise_m_s2=0.02, alarms=("innovation",)),
        log.fly("identified", (0.06, 0.06, 0.06), noise_m_s2=4.0, alarms=("innovation",)),
        log.fly("extended", (1e-3, 0.0, -1e-3), noise_m_s2=0.02),
    ]

    table_text, summary = summarize(log, *flights)

    assert "the identified model cuts it from 100 to 60 mA rms; the extended model cuts it from 60 to 1 mA" in summary
    assert summary.endswith("below 5 mA; the extended twin raises no alarm.")
    rows = {line.split()[0]: line.split()[1:] for line in table_text.splitlines()}
    assert rows["3.00"][2::2] == ["+0.100", "+0.060", "+0.000"]
    assert rows["alarms"] == ["raised", "1", "1", "0"]


def test_the_causes_of_a_diagnosis_are_named() -> None:
    sits = "the coil sits 2.4 mm higher than in the model"
    cause = Cause(name="air-gap-offset", sentence=sits, confidence=0.9, confounders={}, experiments={})

    named = conclusion(Diagnosis(verdict="causes-found", sentence="", causes=(cause,)))
    part = conclusion(Diagnosis(verdict="unknown-cause", sentence="", causes=(cause,)))
    none = conclusion(Diagnosis(verdict="model-adequate", sentence="The model is adequate."))

    assert named == "Cause: air-gap-offset (the coil sits 2.4 mm higher than in the model)."
    assert part.endswith("no known cause explains it.")
    assert none == "Cause: The model is adequate."
