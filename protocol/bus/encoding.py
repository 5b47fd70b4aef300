"""Names of the message classes in zenoh and MCAP, and their descriptor set.

The zenoh encoding is `application/protobuf;board51.v1.State`.  The MCAP schema is `board51.v1.State` with the
serialised FileDescriptorSet, so that any protobuf tool can decode a log without this repository.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, SupportsBytes, TypeVar

from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper
from google.protobuf.message import DecodeError, Message

from protocol.bus import board51_pb2 as pb

MIME = "application/protobuf"
M = TypeVar("M", bound=Message)
REPLAYED = b"replayed"  # zenoh attachment of each message that a replay sends; its payload is that of the log
SCHEMA_ENCODING = MESSAGE_ENCODING = "protobuf"
# Size of a log's chunks before compression, 0.3 s of one board: a damaged byte costs at least one chunk.  Compared with
# chunks of 1 MiB, files are 22 % larger with zstd and 6 % with lz4.
CHUNK_BYTES = 1 << 14
# The topic that carries the messages of each of these together, and their field in it.
BATCH_OF = {"state": "states", "twin/state": "twin/states", "twin/divergence": "twin/states"}
_FIELD_OF = {
    "state": pb.StateBatch.STATES_FIELD_NUMBER,
    "twin/state": pb.TwinBatch.STATES_FIELD_NUMBER,
    "twin/divergence": pb.TwinBatch.DIVERGENCES_FIELD_NUMBER,
}
LARGEST = 1e12  # in SI units: gains are the largest numbers, at most 1e6 by default


def schema_name(message: type[Message]) -> str:
    """Return the name of a message class, such as `board51.v1.State` for pb.State."""
    return str(message.DESCRIPTOR.full_name)


def zenoh_encoding(message: type[Message]) -> str:
    """Return the zenoh encoding of a message class; subscribers may check it before they parse."""
    return f"{MIME};{schema_name(message)}"


def is_plausible(message: Message) -> bool:
    """Return whether all numbers of a message itself are finite and of a size that something on a rig can have."""
    fields: Any = message.ListFields()
    numbers = (value if field.is_repeated else (value,) for field, value in fields if field.type == field.TYPE_DOUBLE)
    return all(abs(number) <= LARGEST for values in numbers for number in values)  # false for NaN, too


def word_of(kind: EnumTypeWrapper, number: int) -> str:
    """Return the name of an enum's value in words, `closed loop`; one that this version does not know, as digits."""
    known = kind.DESCRIPTOR.values_by_number.get(number)
    return str(number) if known is None else known.name.partition("_")[2].lower().replace("_", " ")


def is_replayed(attachment: SupportsBytes | None) -> bool:
    """Return whether the attachment of a message on the bus marks it as sent by a replay."""
    return attachment is not None and bytes(attachment) == REPLAYED


def descriptor_set() -> bytes:
    """Return the serialised FileDescriptorSet of board51.proto, which has no imports."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet  # slow to load, and needed by logs alone

    files = FileDescriptorSet()
    pb.DESCRIPTOR.CopyToProto(files.file.add())
    return files.SerializeToString(deterministic=True)


def parse(message: type[M], data: bytes) -> M | None:
    """Parse a message; return None if `data` is malformed, which is an expected outcome on a bus."""
    try:
        return message.FromString(data)
    except DecodeError:
        return None


def stamp_ns(message: Message) -> int | None:
    """Return the time that a message bears, the gateway's clock; None for those that bear none (twin/state, ...)."""
    stamp: int = getattr(message, "host_time_ns", getattr(message, "received_ns", 0))
    return stamp or None  # 0: a sender that knew no time, or an older one


def batch(topic: str, messages: Iterable[bytes]) -> bytes:
    """Return the batch, for BATCH_OF[topic], of serialised messages of one topic: each behind its tag and length."""
    # Joined as bytes: the messages are serialised already, and a message of them would parse each again.
    tag, data = _FIELD_OF[topic] << 3 | 2, bytearray()  # 2: a length follows
    for message in messages:
        data.append(tag)
        rest = len(message)
        while rest > 0x7F:
            data.append(rest & 0x7F | 0x80)
            rest >>= 7
        data.append(rest)
        data += message
    return bytes(data)


def parts(topic: str, message: Message) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of each part of a batch; any other message is its own only part."""
    match message:
        case pb.StateBatch():
            yield from (("state", state) for state in message.states)
        case pb.TwinBatch():
            yield from (("twin/state", state) for state in message.states)
            yield from (("twin/divergence", divergence) for divergence in message.divergences)
        case _:
            yield topic, message
