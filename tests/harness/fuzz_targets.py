"""The code that meets bytes from outside, as functions of bytes: the table of `tests/harness/fuzzing.py`.

A file's reader is that of `hostile_files.READERS`.  Messages of the bus, records of a log and frames of a line are
packed into one input, each behind its kind and length, so that changed bytes still make a valid log or a right CRC.
"""

from __future__ import annotations

import json
import math
import struct
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from google.protobuf.message import Message

from gateway.client.values import Capture, Sample, read_log
from gateway.sites.server import LogServer
from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import parse, parts
from protocol.bus.topics import TOPICS
from protocol.errors import Board51Error, DataError
from protocol.wire.decoder import StreamDecoder
from protocol.wire.framing import cobs_decode, encode_frame
from protocol.wire.session import Session
from tests.harness import mutations
from tests.harness.gateway.board_host import FIRMWARES
from tests.harness.gateway.gateway_peers import frame, identity_values, parameters_values
from tests.harness.gateway.lossy_line import LossyRig
from tests.harness.hostile_bus import USUAL, show
from tests.harness.hostile_files import READERS, Reader
from tests.harness.hostile_messages import COMMANDS, message, usual_messages, write_log, write_payloads
from tests.harness.hostile_opcua import serve
from tests.harness.twin.true_model import true_model
from twin.mirror.bus.handover import read_command, read_model
from twin.mirror.mirror import Mirror
from twin.model.parameters import Model

SEEDS = 24
_HEAD = struct.Struct("<BH")
_NAMES = [topic.name for topic in TOPICS]
_KINDS = {topic.name: topic.message for topic in TOPICS}
# Files that say which numbers a program computes with: none of them is NaN or infinite.
_FINITE = {"campaign", "plant", "own rig", "configuration", "model", "controller", "gains", "diagnosis", "run", "users"}


class FuzzError(AssertionError):
    """The parser returned what it promises to refuse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A parser: valid inputs to begin with, a change that keeps an input well-formed, and what is done with it.

    `run` raises nothing on any input: the documented errors are judged within.
    """

    seeds: Callable[[Path], Iterable[bytes]]
    change: Callable[[Random, bytes], bytes]
    run: Callable[[Path, bytes], None]


# ---- packed messages


def pack(parts: Iterable[tuple[str, bytes]]) -> bytes:
    """Return messages, by topic, as one input."""
    return b"".join(_HEAD.pack(_NAMES.index(name), len(data)) + data for name, data in parts if len(data) < 1 << 16)


def unpack(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield topic and payload of each message; any bytes are some messages."""
    at = 0
    while at + _HEAD.size <= len(data):
        number, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        yield _NAMES[number % len(_NAMES)], data[at : at + length]
        at += length


def parsed(data: bytes) -> Iterator[tuple[str, Message]]:
    """Yield those that are messages, as a subscriber takes them."""
    for name, payload in unpack(data):
        item = parse(_KINDS[name], payload)
        if item is not None:
            yield name, item


def change_messages(chance: Random, data: bytes) -> bytes:
    """Change fields of a message, or drop, double or exchange messages."""
    parts = list(unpack(data))
    if not parts:
        return data
    at = chance.randrange(len(parts))
    match chance.randrange(6):
        case 0:
            del parts[at]
        case 1:
            parts.insert(at, chance.choice(parts))
        case 2:
            parts[at] = parts[at][0], mutations.binary(chance, parts[at][1])
        case _:
            name, payload = parts[at]
            valid = parse(_KINDS[name], payload)
            parts[at] = name, message(chance, valid or _KINDS[name]()).SerializeToString()
    return pack(parts)


def _packed(messages: Iterable[tuple[str, Message]]) -> bytes:
    return pack((name, item.SerializeToString()) for name, item in messages)


def _short() -> list[tuple[str, Message]]:
    """A flight of few samples: an input is small."""
    usual = usual_messages()
    return [*usual[:12], *usual[-6:]]


# ---- files


def _of_reader(name: str, reader: Reader) -> Target:
    def seeds(folder: Path) -> Iterator[bytes]:
        for n in range(SEEDS):
            yield reader.make(Random(n), folder / "scratch")

    def run(folder: Path, data: bytes) -> None:
        path = folder / reader.file
        path.write_bytes(data)
        _read(reader, path, finite=name in _FINITE)

    return Target(seeds=seeds, change=_CHANGES.get(Path(reader.file).suffix, mutations.binary), run=run)


def _of_log(reader: Reader) -> Target:
    """A reader of logs, on whole logs of odd messages."""

    def run(folder: Path, data: bytes) -> None:
        path = folder / reader.file
        write_payloads(path, unpack(data))
        _read(reader, path, finite=False)

    return Target(seeds=lambda _: [_packed(_short())], change=change_messages, run=run)


def _read(reader: Reader, path: Path, *, finite: bool) -> None:
    try:
        result = reader.read(path)
    except Board51Error as error:
        if not any(name in str(error) for name in (str(path.parent), *reader.names)):
            raise FuzzError(f"an error that names nothing: {error}") from error
        return
    if finite:
        check_finite(result)


def check_finite(value: Any) -> None:
    """Raise FuzzError if a number in a tree of dataclasses, tables and lists is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise FuzzError(f"{value} was accepted")
    inner: Iterable[Any] = ()
    if is_dataclass(value) and not isinstance(value, type):
        inner = (getattr(value, name) for name in value.__dataclass_fields__)
    elif isinstance(value, Mapping):
        inner = value.values()
    elif isinstance(value, list | tuple):
        inner = value
    for item in inner:
        check_finite(item)


def _change_toml(chance: Random, data: bytes) -> bytes:
    try:
        return mutations.as_toml(mutations.tree(chance, tomllib.loads(data.decode())))
    except (ValueError, RecursionError):
        return mutations.binary(chance, data)


def _change_json(chance: Random, data: bytes) -> bytes:
    try:
        return mutations.as_json(mutations.tree(chance, json.loads(data)))
    except (ValueError, RecursionError, OverflowError):
        return mutations.binary(chance, data)


def _change_text(chance: Random, data: bytes) -> bytes:
    try:
        return mutations.text(chance, data)
    except UnicodeDecodeError:
        return mutations.binary(chance, data)


_CHANGES = {".toml": _change_toml, ".json": _change_json, ".csv": _change_text}

# ---- the line


def _wire(_: Path, data: bytes) -> None:
    """Decode at once and byte by byte; a session takes it, too."""
    whole, bytewise = StreamDecoder().feed(data), StreamDecoder()
    if whole != [event for at in range(len(data)) for event in bytewise.feed(data[at : at + 1])]:
        raise FuzzError("the decoder depends on the pieces")
    session = Session(choose_session=lambda: 7)
    session.connect(0.0)
    for n in range(0, len(data), 40):
        session.feed(data[n : n + 40], n * 1e-3)
        session.poll(n * 1e-3)
        session.output()
    session.disconnect()


def _driver(_: Path, data: bytes) -> None:
    """A gateway's driver is in step with its board, then a frame of each length with a right CRC comes."""
    rig = LossyRig(FIRMWARES["python"], seed=0, loss=0.0, divider=1)
    rig.run(60)
    at = 0
    while at < len(data):
        length = data[at] % 48
        rig.driver.received(encode_frame(data[at + 1 : at + 1 + length] or b"\x01"), rig.now_ns)
        at += 1 + length
        rig.run()


def _frames() -> list[bytes]:
    states = [item.data for _, item in usual_messages() if isinstance(item, pb.RawBytes)][1:9]
    parameters = frame("PARAMETERS", id=2, **parameters_values())
    return [frame("IDENTITY", id=1, tick=90, **identity_values()), parameters, *states]


def _wire_seeds(_: Path) -> Iterator[bytes]:
    yield b"".join(_frames())
    yield from _frames()


def _driver_seeds(_: Path) -> Iterator[bytes]:
    bodies = [(cobs_decode(frame.strip(b"\0")) or b"")[:-2] for frame in _frames()]
    parts = [bytes([len(body)]) + body for body in bodies]
    yield b"".join(parts)
    yield from parts


# ---- the bus


def _single_samples(data: bytes) -> list[Message]:
    """Return the messages as a feed takes them: each sample alone."""
    return [part for name, item in parsed(data) for _, part in parts(name, item)]


def _view(_: Path, data: bytes) -> None:
    """Process messages as pages, API and Foxglove do."""
    show(_single_samples(data), later_s=1.5)


def _opcua(_: Path, data: bytes) -> None:
    serve(_single_samples(data))


def _client(_: Path, data: bytes) -> None:
    """Make the samples and captures that a user's own program gets."""
    for _name, item in parsed(data):
        if isinstance(item, pb.State):
            with suppress(DataError):
                Sample.of(item)
        elif isinstance(item, pb.CaptureRecord):
            with np.errstate(all="ignore"):  # an absurd T_s is passed on
                Capture.of(item)


def _mirror(_: Path, data: bytes) -> None:
    """Pass samples and parameters to the twin; an error here ends it."""
    mirror = Mirror(Model.load("ce152"))
    for _name, item in parsed(data):
        match item:
            case pb.Parameters():
                mirror.parameters(item)
            case pb.State():
                mirror.handle(item)
            case pb.StateBatch():
                for state in item.states:
                    mirror.handle(state)


def _hand_over(_: Path, data: bytes) -> None:
    command = read_command(data)
    if isinstance(command, pb.TwinCommand):
        belief = read_model(command)
        if not isinstance(belief, pb.CommandReply):
            check_finite(belief.model)


def _hand_over_seeds(_: Path) -> Iterator[bytes]:
    text = json.dumps(true_model(effects={"quadratic-drag": 1.0}).to_json())
    yield pb.TwinCommand(id="a", who="b", use_model=pb.UseModel(model_json=text)).SerializeToString()


def _change_hand_over(chance: Random, data: bytes) -> bytes:
    command = parse(pb.TwinCommand, data)
    if command is None or not chance.randrange(4):
        return mutations.binary(chance, data)
    command.use_model.model_json = _change_json(chance, command.use_model.model_json.encode()).decode(errors="replace")
    return command.SerializeToString()


def _command(_: Path, data: bytes) -> None:
    """A gateway with a board answers each command once, and by no error of ours."""
    rig = LossyRig(FIRMWARES["python"], seed=0, loss=0.0)
    rig.run(60)
    replies: list[pb.CommandReply] = []
    rig.send_bytes(data, replies)
    rig.run(200)
    if len(replies) != 1 or replies[0].reason == "internal-error":
        raise FuzzError(f"{replies}")


def _change_field(kind: type[Message], chance: Random, data: bytes) -> bytes:
    valid = parse(kind, data)
    if valid is None or not chance.randrange(4):
        return mutations.binary(chance, data)
    return message(chance, valid).SerializeToString()


def _log_request(folder: Path, data: bytes) -> None:
    _served(folder).answer(data)


def _served(folder: Path) -> LogServer:
    if not (folder / "log.mcap").exists():
        write_log(folder / "log.mcap", _short())
    return LogServer(folder, "site")


def _log_request_seeds(folder: Path) -> Iterator[bytes]:
    whole = pb.LogRequest(part="log.mcap").SerializeToString()
    yield whole
    for block in _served(folder).answer(whole).blocks:
        yield pb.LogRequest(part="log.mcap", block=block).SerializeToString()


def _usual(_: Path) -> Iterator[bytes]:
    yield _packed(_short())
    names = {topic.message: topic.name for topic in TOPICS}
    yield _packed((names[type(item)], item) for item in USUAL[-12:] if type(item) in names)


def _targets() -> dict[str, Target]:
    bus = partial(Target, seeds=_usual, change=change_messages)
    targets = {
        "wire": Target(seeds=_wire_seeds, change=mutations.binary, run=_wire),
        "driver": Target(seeds=_driver_seeds, change=mutations.binary, run=_driver),
        "bus, views": bus(run=_view),
        "bus, OPC UA": bus(run=_opcua),
        "bus, client": bus(run=_client),
        "bus, twin": bus(run=_mirror),
        "bus, command": Target(
            seeds=lambda _: [item.SerializeToString() for item in COMMANDS],
            change=partial(_change_field, pb.Command),
            run=_command,
        ),
        "bus, model": Target(seeds=_hand_over_seeds, change=_change_hand_over, run=_hand_over),
        "bus, log request": Target(
            seeds=_log_request_seeds, change=partial(_change_field, pb.LogRequest), run=_log_request
        ),
    }
    for name, reader in READERS.items():
        targets[name] = _of_log(reader) if name.startswith("log") else _of_reader(name, reader)
    client = Reader("log.mcap", READERS["log"].make, read_log)
    return targets | {"log, client": _of_log(client)}


TARGETS = _targets()
