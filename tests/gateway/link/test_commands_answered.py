"""Every command is answered and recorded, whatever it says and whatever goes wrong."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.access.roles import Role
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.gateway_peers import frame
from tests.harness.gateway.played_commands import START_NS, Rig, S


def test_a_fault_in_a_handler_costs_one_command_and_it_is_answered_and_recorded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    assert rig.known.scaling is not None
    good, rig.known.scaling = rig.known.scaling, replace(rig.known.scaling, x_lsb_m=0.0)  # no board is let in with it

    reply = rig.command(id="a", set_reference=pb.SetReference(x_ref_m=1e-3))
    rig.known.scaling = good

    assert (reply.id, reply.refused_by, reply.reason) == ("a", "gateway", "internal-error")
    assert [record.command.id for record in rig.records] == ["a"]
    assert "ZeroDivisionError" in caplog.text
    assert rig.command(id="a", set_reference=pb.SetReference(x_ref_m=1e-3)).accepted


PLANT = pb.Plant(name="rig", mass_kg=20e-3, travel_m=12e-3, x_max_m=16e-3, gravity_m_s2=9.81)


@pytest.mark.parametrize(("role", "accepted"), [(Role.VIEWER, False), (Role.OPERATOR, False), (Role.ENGINEER, True)])
def test_only_an_engineer_states_the_plant_and_a_stop_does_not_give_it_up(role: Role, accepted: bool) -> None:
    rig = Rig()
    rig.now_s += 10.0
    request = pb.Command(id="1", issued_ns=rig.now_ns, set_plant=pb.SetPlant(plant=PLANT)).SerializeToString()
    rig.request(pb.Command(stop=pb.Stop()).SerializeToString(), role=role)

    (reply,) = rig.request(request, role=role)

    assert reply.accepted == accepted
    assert reply.reason == ("" if accepted else "not-allowed")
    assert rig.handler.plant_card.card.who == ("ben" if accepted else "")
    assert [event.text for event in rig.sink.messages["event"]] == accepted * [
        "ben: a ball of 20 g, travel 12 mm, x_max 16 mm, g 9.81 m/s2; before: not stated"
    ]


DOUBLES = st.floats() | st.sampled_from([0.0, 5e-324, -5e-324, 1e308, -1e308, 2.0**53, 1e-9])
UINTS = st.integers(0, 2**32 - 1)
ENUMS = st.integers(-(2**31), 2**31 - 1) | st.integers(-1, 8)
KINDS = {
    "set_mode": st.builds(pb.SetMode, mode=ENUMS),
    "set_reference": st.builds(pb.SetReference, x_ref_m=DOUBLES),
    "set_gains": st.builds(
        pb.SetGains, law=ENUMS, gains=st.lists(DOUBLES, min_size=3, max_size=5), i_0_a=DOUBLES, x_0_m=DOUBLES,
        u_0_v=DOUBLES,
    ),
    "excite": st.builds(
        pb.Excite, shape=ENUMS, on_reference=st.booleans(), amplitude=DOUBLES, offset=st.none() | DOUBLES,
        period_s=DOUBLES, period_end_s=DOUBLES, seed=UINTS, duration_s=DOUBLES,
    ),
    "capture": st.builds(pb.Capture, u_from_v=DOUBLES, u_to_v=DOUBLES, duration_s=DOUBLES, pre_s=DOUBLES),
    "set_stream": st.builds(pb.SetStream, divider=UINTS),
    "set_host_loss": st.builds(pb.SetHostLoss, policy=UINTS, timeout_s=DOUBLES),
    "stop": st.just(pb.Stop()),
    "ping": st.just(pb.Ping()),
    "mark": st.builds(pb.Mark, text=st.text(max_size=300)),
    "acknowledge": st.builds(pb.Acknowledge, alarm=st.text(max_size=100), comment=st.text(max_size=300)),
    "set_plant": st.builds(
        pb.SetPlant, confirmed=st.booleans(),
        plant=st.none() | st.builds(
            pb.Plant, name=st.text(max_size=70), mass_kg=DOUBLES, travel_m=DOUBLES, x_max_m=DOUBLES,
            gravity_m_s2=DOUBLES, ball_diameter_m=st.none() | DOUBLES,
        ),
    ),
}  # fmt: skip
COMMANDS = st.one_of(
    [
        st.builds(
            pb.Command, id=st.text(min_size=1, max_size=130), who=st.text(max_size=130), valid_s=DOUBLES,
            issued_ns=st.sampled_from([0, START_NS + 100 * S]), **{kind: values},
        )
        for kind, values in KINDS.items()
    ]
)  # fmt: skip


def test_the_commands_of_the_property_are_all_that_there_are() -> None:
    assert set(KINDS) == {field.name for field in pb.Command.DESCRIPTOR.oneofs_by_name["what"].fields}


@pytest.mark.slow
@settings(max_examples=800, suppress_health_check=[HealthCheck.too_slow])
@given(command=COMMANDS, flags=st.sampled_from([0, 1, 2, 0x82]))
def test_whatever_a_command_says_it_is_answered_with_its_id_and_recorded(command: pb.Command, flags: int) -> None:
    rig = Rig()
    for n in range(2):
        for event in rig.session.feed(
            frame("STATE", sequence=rig.tick + n, i_c=1, x=2, u_c=3, x_ref=1000, flags=flags), rig.now_s
        ):
            rig.known.sample = event  # type: ignore[assignment]  # samples alone come of states
    rig.now_s += 0.01

    (reply,) = rig.request(command.SerializeToString())

    (record,) = rig.records
    is_stop = command.WhichOneof("what") == "stop"
    assert reply.id == (command.id[:128] if is_stop else command.id)
    assert reply.reason != "internal-error", reply.text
    assert reply.accepted or (reply.reason and reply.text)
    assert record.reply == reply


def test_bytes_of_any_kind_are_answered_and_recorded() -> None:
    rng, rig = random.Random(5), Rig()
    good = pb.Command(id="a", who="b", excite=pb.Excite(shape=pb.SHAPE_PRBS, offset=1.0)).SerializeToString()
    for n in range(3000):
        data = bytearray(good + rng.randbytes(rng.randrange(8)))
        for _ in range(rng.randrange(5)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        rig.now_s += 0.01

        rig.request(bytes(data))
        rig.handler._retained.clear()

        assert len(rig.records) == n + 1
        assert rig.records[-1].reply.reason != "internal-error"
