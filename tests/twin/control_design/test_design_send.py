"""`--send` on a real bus: a router in this process that answers as a gateway does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zenoh

import board51
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.endpoint import zenoh_config
from tests.harness.ports import free_endpoint
from tests.harness.repeated import repeated
from tests.harness.twin.rig import Rig


@contextmanager
def gateway(endpoint: str, parameters: pb.Parameters, *, accepts: bool) -> Iterator[list[pb.Command]]:
    """Publishes `parameters` until the end, answers every command; yields the commands."""
    received: list[pb.Command] = []
    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:

        def answer(query: zenoh.Query) -> None:
            assert query.payload is not None
            command = pb.Command.FromString(query.payload.to_bytes())
            received.append(command)
            reply = pb.CommandReply(id=command.id, accepted=accepts, tick=77)
            if not accepts:
                reply.refused_by, reply.reason = "board", "fault-active"
            query.reply(query.key_expr, reply.SerializeToString())

        session.declare_queryable(topics.key("lab", "rig1", "command"), answer)
        key, data = topics.key("lab", "rig1", "parameters"), parameters.SerializeToString()
        with repeated(lambda: session.put(key, data), 0.05):
            yield received


def board() -> pb.Parameters:
    parameters = Rig().parameters()
    parameters.x_ref_min_m, parameters.x_ref_max_m, parameters.u_max_v = 0.3e-3, 5.2e-3, 5.0
    return parameters


def test_the_board_gets_gains_and_operating_point(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()

    with gateway(endpoint, board(), accepts=True) as received:
        code = board51.main(["design", "ce152", "--send", "rig1", "--site", "lab", "--connect", endpoint])

    assert code == 0
    assert "in force from tick 77" in capsys.readouterr().err
    (command,) = received
    gains = command.set_gains
    assert gains.law == pb.LAW_LQI
    assert len(gains.gains) == 4
    assert gains.gains[3] < 0.0
    assert gains.x_0_m == pytest.approx(2.85e-3)
    assert gains.u_0_v == pytest.approx(1.649, abs=1e-3)


def test_a_refusal_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()

    with gateway(endpoint, board(), accepts=False):
        code = board51.main(["design", "ce152", "--send", "rig1", "--site", "lab", "--connect", endpoint])

    assert code == 1
    assert "fault-active" in capsys.readouterr().err


def test_gains_of_another_sample_time_are_not_sent(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    words = ["design", "ce152", "--sample-time", "0.001", "--send", "rig1", "--site", "lab", "--connect", endpoint]

    with gateway(endpoint, board(), accepts=True) as received:
        code = board51.main(words)

    assert code == 2
    assert not received
    assert "--sample-time 0.002" in capsys.readouterr().err
