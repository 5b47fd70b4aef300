"""The table of `board51 watch --table`: what is on the line of a rig, and for how long."""

from __future__ import annotations

import time

import pytest

import board51
from gateway.commands.watch_table import FRESH_ALARMS_S, FRESH_S, Table
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import played_gateway, ticking

STATE = pb.State(x_m=3.1234e-3, x_ref_m=3e-3, i_c_a=0.6, mode=pb.MODE_CLOSED_LOOP)


def table_at_zero() -> Table:
    table = Table()
    divergence = pb.Divergence(x_m=pb.SignalDivergence(error=-12e-6))
    for topic, message in (
        ("status", pb.Status(link="streaming")),
        ("states", pb.StateBatch(states=[STATE])),
        ("twin/states", pb.TwinBatch(divergences=[divergence])),
        ("alarms", pb.Alarms(active=[pb.Alarm(name="link-down")])),
        ("twin/alarm", pb.Alarm(name="divergence-x", active=True)),
    ):
        table.take(f"board51/rig1/{topic}", message, 0.0)
    return table


def test_a_line_has_link_mode_values_divergence_and_alarms() -> None:
    _, line = table_at_zero().lines(1.0)

    assert line.split() == [
        *("rig1", "streaming", "closed-loop", "3.123", "3.000", "0.600", "-0.012"),
        *("link-down,", "divergence-x"),
    ]


def test_what_is_no_longer_said_is_no_longer_shown() -> None:
    table = table_at_zero()

    assert table.lines(FRESH_S)[1].split()[:8] == ["rig1", "no", "gateway", "-", "-", "-", "-", "-"]
    assert table.lines(FRESH_ALARMS_S)[1].endswith("  -")


def test_an_alarm_that_ended_leaves_the_line() -> None:
    table = table_at_zero()

    table.take("board51/rig1/twin/alarm", pb.Alarm(name="divergence-x", active=False), 1.0)

    assert table.lines(1.0)[1].endswith("  link-down")


def test_the_command_prints_a_line_for_each_rig(capsys: pytest.CaptureFixture[str]) -> None:
    with played_gateway() as gateway:
        began_s = time.monotonic()
        words = ["--connect", gateway.endpoint, "--every", "0.2", "--count", "2", "--timeout", "60"]
        with ticking(gateway, "rig2", "rig1", period_s=0.02):
            code = board51.main(["watch", "--table", *words])
            took_s = time.monotonic() - began_s

    lines = capsys.readouterr().out.splitlines()
    assert code == 0
    assert took_s >= 0.4
    assert [line.split()[0] for line in lines[-3:]] == ["rig", "rig1", "rig2"]
    assert "3.000" in lines[-1]


def test_a_table_takes_no_topics(capsys: pytest.CaptureFixture[str]) -> None:
    assert board51.main(["watch", "--table", "--topic", "state"]) == 2
    assert "Leave out --topic" in capsys.readouterr().err
