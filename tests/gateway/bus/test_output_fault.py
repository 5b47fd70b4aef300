"""A board whose coil cannot be switched off, behind a real gateway: everybody is told to cut the supply."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from gateway.board import faults
from gateway.bus.status import fault_condition
from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.line import Board
from gateway.emulator.native.board import NativeFirmware
from gateway.emulator.serve import Emulator
from gateway.link import event_text
from gateway.views.alarms import AlarmBook
from protocol.bus import board51_pb2 as pb
from protocol.wire.events import BoardEvent
from protocol.wire.messages import EventCode, Flag
from tests.harness.gateway.board_host import skip_without_compiler
from tests.harness.gateway.gateway_peers import gateway_and_client, gateway_config, wait_for

OFFSET_V = 2.0


@pytest.mark.parametrize("firmware", [Firmware, NativeFirmware])
def test_a_stop_at_a_deaf_converter_becomes_an_alarm_and_u_c_stays_what_it_was(
    firmware: Callable[..., Board],
) -> None:
    skip_without_compiler()
    with Emulator(firmware=firmware) as emulator:
        with gateway_and_client(gateway_config(*emulator.urls)) as bus:
            bus.await_states(10)
            assert bus.command("a", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)).accepted
            assert bus.command("b", excite=pb.Excite(offset=OFFSET_V, period_s=0.002, seed=1, duration_s=60.0)).accepted
            wait_for(lambda: bus.states()[-1].u_c_v > OFFSET_V - 0.01, "the input")
            emulator.inject("deaf=1000")

            stop = bus.command("c", stop=pb.Stop())
            event = bus.await_event(faults.OUTPUT_FAULT)
            state = wait_for(lambda: next((s for s in bus.states() if s.flags & Flag.FAULT), None), "the flag")
            wait_for(lambda: {a.name for m in bus.messages["rig/alarms"][-1:] for a in m.active}, "the alarm")
            alarm = bus.messages["rig/alarms"][-1].active[0]

    assert stop.accepted
    assert (event.severity, event.source) == ("fault", "board")
    assert faults.COIL_MAY_BE_ON in event.text
    assert state.mode == pb.MODE_IDLE
    assert state.u_c_v == pytest.approx(OFFSET_V, abs=0.01)
    assert (alarm.name, alarm.text) == (event.name, event.text)


def test_a_driver_that_stays_on_is_told_although_the_converter_confirms_0() -> None:
    with Emulator() as emulator, gateway_and_client(gateway_config(*emulator.urls)) as bus:
        bus.await_states(10)
        assert bus.command("a", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)).accepted
        assert bus.command("b", excite=pb.Excite(offset=OFFSET_V, period_s=0.002, seed=1, duration_s=60.0)).accepted
        wait_for(lambda: bus.states()[-1].i_c_a > 0.4, "the current")
        emulator.inject("stuck=1000")

        bus.command("c", stop=pb.Stop())
        event = bus.await_event("uncommanded-current")

    assert faults.COIL_MAY_BE_ON in event.text


@pytest.mark.parametrize("code", sorted(set(EventCode)))
def test_only_a_fault_that_the_board_can_end_is_told_with_the_coil_off(code: EventCode) -> None:
    name, severity, text = event_text.of_board(BoardEvent(code=code, detail=1, tick=1, missed=0))

    assert name == faults.name_of(code)
    assert (faults.COIL_MAY_BE_ON in text) == (name in faults.COIL)
    assert name not in faults.COIL or (severity == "fault" and "coil off" not in text)


def test_a_rejected_setting_is_named() -> None:
    event = event_text.of_board(BoardEvent(code=EventCode.SETTINGS_REJECTED, detail=17, tick=0, missed=0))

    assert event[:2] == ("settings-rejected", "warning")
    assert "u_max" in event[2]


def test_a_gateway_that_has_missed_the_event_sees_it_in_u_c() -> None:
    earlier = pb.Event(name="sensor-fault", text="earlier")

    assert set(fault_condition(None, 1759)) == {faults.OUTPUT_FAULT}
    assert set(fault_condition(earlier, 1759)) == {faults.OUTPUT_FAULT}
    assert set(fault_condition(earlier, 0)) == {"sensor-fault"}
    assert set(fault_condition(None, 0)) == {faults.FAULT}


def test_of_two_faults_a_view_names_the_one_that_the_board_cannot_end() -> None:
    book = AlarmBook("rig")
    book.event(pb.Event(name="over-current", severity="fault"), 1)
    book.event(pb.Event(name="uncommanded-current", severity="fault"), 2)

    assert book.fault() == "uncommanded-current"
