"""Messages of the bus with fields that no program of ours would write, and logs that hold them."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path
from random import Random
from typing import Any

from google.protobuf.message import Message
from hypothesis import HealthCheck, settings

from gateway.record.writer import LogWriter
from protocol.bus import board51_pb2 as pb
from tests.examples import costly
from tests.harness.gateway.gateway_peers import frame, identity_values, parameters_values

EXAMPLES = os.environ.get("BOARD51_FUZZ_EXAMPLES", "")  # how many, and then other ones each time
fuzzed = settings(
    max_examples=int(EXAMPLES or costly(40)),
    derandomize=not EXAMPLES,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
START_NS = 1_700_000_000_000_000_000
_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 5e-324, -1.0, 1e9)
_WHOLE = {3: 64, 4: 64, 5: 32, 6: 64, 13: 32, 14: 32}  # protobuf types: int64, uint64, int32, fixed64, uint32, enum
_TEXTS = ("", "x" * 5000, "\x00", "\x1b[2J", "rig1/state", "../..", "é\u202e")

COMMANDS = (
    pb.Command(id="a", set_mode=pb.SetMode(mode=pb.MODE_OPEN_LOOP)),
    pb.Command(id="a", set_reference=pb.SetReference(x_ref_m=3e-3)),
    pb.Command(id="a", set_gains=pb.SetGains(gains=[0.49, 1700.0, 17.7, -17600.0], i_0_a=0.6, x_0_m=3e-3, u_0_v=2.1)),
    pb.Command(id="a", excite=pb.Excite(shape=pb.SHAPE_CHIRP, amplitude=0.1, offset=1.0, period_s=1.0, duration_s=1.0)),
    pb.Command(id="a", capture=pb.Capture(u_from_v=1.0, u_to_v=2.0, duration_s=0.02, pre_s=0.001)),
    pb.Command(id="a", set_stream=pb.SetStream(divider=2)),
    pb.Command(id="a", set_host_loss=pb.SetHostLoss(policy=1, timeout_s=1.0)),
    pb.Command(id="a", mark=pb.Mark(text="here")),
    pb.Command(id="a", acknowledge=pb.Acknowledge(alarm="link-down", comment="seen", shelve_s=10.0)),
    pb.Command(id="a", set_plant=pb.SetPlant(plant=pb.Plant(mass_kg=8e-3, travel_m=5e-3, x_max_m=8e-3))),
    pb.Command(id="a", stop=pb.Stop()),
)  # fmt: skip


def message(chance: Random, valid: Message) -> Message:
    """Return a copy with one to three fields changed."""
    mutant = type(valid)()
    mutant.CopyFrom(valid)
    for _ in range(chance.randint(1, 3)):
        inner = _inner(mutant)
        _change(chance, chance.choice(inner))
    return mutant


def _inner(outer: Message) -> list[Message]:
    messages = [outer]
    fields: Any = outer.ListFields()
    for field, value in fields:
        if field.type == field.TYPE_MESSAGE and not field.message_type.GetOptions().map_entry:
            for item in value if field.is_repeated else [value]:
                messages += _inner(item)
    return messages


def _change(chance: Random, target: Message) -> None:
    fields: Any = target.DESCRIPTOR.fields
    if not fields:
        return
    field = chance.choice(fields)
    if chance.randrange(5) == 0:
        target.ClearField(field.name)
    elif field.type == field.TYPE_MESSAGE:
        if field.message_type.GetOptions().map_entry:
            target.ClearField(field.name)
        elif field.is_repeated:
            getattr(target, field.name).add()
        else:
            getattr(target, field.name).SetInParent()
    elif field.is_repeated:
        values = getattr(target, field.name)
        values.extend([_value(chance, field.type)] * chance.choice([1, 3, 1000]))
    else:
        setattr(target, field.name, _value(chance, field.type))


def _value(chance: Random, kind: int) -> Any:
    if kind in _WHOLE:
        bits = _WHOLE[kind]
        low, high = (0, (1 << bits) - 1) if kind in (4, 6, 13) else (-(1 << bits - 1), (1 << bits - 1) - 1)
        return chance.choice([low, high, 0, 1, 7, high // 2])
    if kind in (1, 2):  # double, float
        return chance.choice(_FLOATS)
    if kind == 8:
        return chance.random() < 0.5
    return chance.choice(_TEXTS) if kind == 9 else chance.randbytes(chance.choice([0, 1, 64]))


def usual_messages() -> list[tuple[str, Message]]:
    """Topic and message of a short flight, in the order of a log."""
    parameters = pb.Parameters(
        session=1, host_time_ns=START_NS, firmware="1.0 test", board_id=7, sample_time_s=2e-3, law=pb.LAW_LQI,
        gains=[0.49, 1700.0, 17.7, -17600.0], i_0_a=0.6, x_0_m=2.8e-3, u_0_v=2.1, x_ref_min_m=3e-4, x_ref_max_m=5.2e-3,
        u_max_v=5.0, stream_divider=1, i_lsb_a=5e-4, x_lsb_m=1.4e-6, u_lsb_v=1.2e-3, capture_s=0.08,
    )  # fmt: skip
    identity = frame("IDENTITY", id=1, tick=90, **identity_values())
    messages: list[tuple[str, Message]] = [
        ("raw", pb.RawBytes(host_time_ns=START_NS, data=identity + frame("PARAMETERS", id=2, **parameters_values()))),
        ("parameters", parameters),
    ]
    for tick in range(100, 140):
        at_ns = START_NS + tick * 2_000_000
        state = pb.State(
            sequence=tick, tick=tick, session=1, host_time_ns=at_ns, i_c_a=0.6, x_m=2.8e-3 + 1e-6 * (tick % 7),
            u_c_v=2.1, x_ref_m=2.8e-3, mode=pb.MODE_CLOSED_LOOP, t_s=tick * 2e-3,
        )  # fmt: skip
        wire = frame("STATE", sequence=tick, i_c=1200, x=2000, u_c=1700, x_ref=2000, flags=2)
        messages += [("raw", pb.RawBytes(host_time_ns=at_ns, data=wire)), ("state", state)]
    capture = pb.CaptureRecord(
        host_time_ns=START_NS, session=1, tick=120, sample_time_s=4e-5, u_from_v=1.0, u_to_v=2.0, step_index=2,
        i_c_a=[0.3, 0.3, 0.4, 0.5, 0.6],
    )  # fmt: skip
    event = pb.Event(host_time_ns=START_NS, tick=120, session=1, source="board", severity="fault", name="x", text="y")
    alarm = pb.Alarm(host_time_ns=START_NS, tick=120, session=1, name="divergence-x", active=True, value=4.0)
    twin = pb.TwinState(sequence=120, tick=120, session=1, t_s=0.24, i_c_a=0.6, x_m=2.8e-3, sync="in-step")
    away = pb.Divergence(sequence=120, tick=120, session=1, t_s=0.24, sync="in-step", nis=2.0, nis_mean=2.0)
    return [
        *messages, ("capture", capture), ("event", event), ("twin/alarm", alarm), ("twin/state", twin),
        ("twin/divergence", away), ("status", pb.Status(host_time_ns=START_NS, link="streaming", session=1)),
    ]  # fmt: skip


def write_log(path: Path, messages: list[tuple[str, Message]]) -> bytes:
    """Write a log of these messages, and return its bytes."""
    return write_payloads(path, [(topic, item.SerializeToString()) for topic, item in messages])


def write_payloads(path: Path, payloads: Iterable[tuple[str, bytes]]) -> bytes:
    """Write a log of these payloads by topic, and return its bytes."""
    path.unlink(missing_ok=True)
    writer = LogWriter(path)
    for n, (topic, payload) in enumerate(payloads):
        writer.write(f"board51/rig/{topic}", payload, START_NS + n * 1_000_000)
    writer.close()
    return path.read_bytes()
