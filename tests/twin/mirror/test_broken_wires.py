"""Faults that the board does not look for, as they need a model: a reading that sticks, a coil or a pin without a wire.

The twin raises an alarm (docs/decisions/interface.md, "No fault for a current that does not follow u_c").  x at an end
of its converter is the board's own SENSOR_FAULT.
"""

from __future__ import annotations

import pytest

from gateway.emulator.faults import parse
from gateway.emulator.plant.constants import CE152
from tests.harness.twin.true_model import true_model
from tests.twin.mirror.test_switched_off_in_flight import Flight, alarms, watched

WITHIN = 500  # ticks, 1 s


@pytest.mark.parametrize("fault", ["x-frozen", "i-unplugged", "coil-open", "i-bit=8"])
def test_the_twin_sees_a_broken_wire_within_a_second(fault: str) -> None:
    flight = Flight(2.85e-3, seed=4)
    begun = flight.states[-1].tick
    flight.lab.wiring.follow([parse(fault)])
    flight.run(WITHIN)

    raised = alarms(watched(true_model(CE152), flight.states))

    assert raised
    assert all(begun < tick <= begun + WITHIN for _, tick in raised)
