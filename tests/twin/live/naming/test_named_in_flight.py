"""A cause is named while the rig flies: the truth within 10 s, nothing where nothing is wrong, and an end."""

from __future__ import annotations

import pytest

from gateway.emulator.plant.effects import EFFECTS
from protocol.wire.codec import encode_body
from protocol.wire.framing import encode_frame
from protocol.wire.messages import Mode
from tests.harness.twin.named_flight import NamedFlight, causes_of

WITHIN_S = 10.0
BEFORE_S = 8.0

# At medium strength, in each place of the loop.  Others of the catalogue do not show in these steps, or not so soon:
# the page of the twin lists them.
CAUSES = (
    "coulomb-friction",
    "slew-rate-limit",
    "amplifier-offset",
    "amplifier-dead-zone",
    "motional-emf",
    "sensor-crosstalk",
    "current-sensor-offset",
    "position-sensor-lag",
    "position-sensor-nonlinearity",
    "force-exponent",
)


@pytest.mark.parametrize(
    "cause", [name if name == "coulomb-friction" else pytest.param(name, marks=pytest.mark.slow) for name in CAUSES]
)
def test_a_medium_effect_is_named_within_ten_seconds_of_flight(cause: str) -> None:
    rig = NamedFlight()
    assert rig.run(BEFORE_S) == []
    began_s = rig.now_s

    rig.begin({cause: EFFECTS[cause].medium})
    messages = rig.run(WITHIN_S)

    last = messages[-1]
    assert cause in causes_of(last)
    assert 0.0 < last.probability <= 0.9
    assert last.since_ns / 1e9 == pytest.approx(began_s, abs=4.0)  # a window and a part of one
    assert "the rig behaves as if" in last.sentence


def test_a_ball_at_rest_is_no_evidence() -> None:
    rig = NamedFlight(step_m=0.0)

    assert rig.run(BEFORE_S) == []

    assert rig.namer._theta is None  # no window was evaluated


def test_the_size_is_that_of_the_effect() -> None:
    """Within a third: a score test is linear in the size."""
    rig = NamedFlight()
    rig.run(BEFORE_S)

    rig.begin({"coulomb-friction": 0.002})
    last = rig.run(WITHIN_S)[-1]

    assert (last.cause, last.unit) == ("coulomb-friction", "N")
    assert last.value == pytest.approx(0.002, rel=1.0 / 3.0)
    assert "mN" in last.sentence


@pytest.mark.slow
def test_a_name_ends_with_the_effect() -> None:
    rig = NamedFlight()
    rig.run(BEFORE_S)
    rig.begin({"coulomb-friction": 0.002})
    assert rig.run(WITHIN_S)[-1].cause == "coulomb-friction"

    rig.begin({})
    last = rig.run(2.0 * WITHIN_S)[-1]

    assert (last.cause, last.sentence) == ("", "")


@pytest.mark.slow
def test_a_name_ends_with_the_flight_and_the_model() -> None:
    rig = NamedFlight()
    rig.run(BEFORE_S)
    rig.begin({"coulomb-friction": 0.002})
    assert rig.run(WITHIN_S)[-1].cause == "coulomb-friction"

    rig.lab.request("SET_MODE", mode=int(Mode.IDLE))
    assert rig.run(20.0) == []
    assert rig.run(20.0)[-1].cause == ""

    rig.lift()
    assert rig.run(WITHIN_S)[-1].cause == "coulomb-friction"
    rig.namer.use(rig.model)
    assert rig.run(3.0) == []


@pytest.mark.slow
def test_stops_landings_gains_and_gaps_are_no_cause() -> None:
    rig = NamedFlight(seed=8)
    for _ in range(3):
        assert rig.run(6.0) == []
        rig.lab.firmware.feed(encode_frame(encode_body("STOP", id=255)), into_tick_us=700)
        assert rig.run(1.0) == []  # the fall and the bounces
        rig.lift(0.7e-3)
        assert rig.run(4.0) == []
        rig.lab.states(37)  # lost
        rig.lab.fly()  # the same gains are sent again, and the speed is zero at once
        assert rig.run(5.0) == []
        rig.lift(0.3e-3)
