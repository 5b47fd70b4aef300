"""The baseline: what one would write first to get from ptys to zenoh and MCAP, in one file and one thread.

    python bare_loop.py FOLDER BOARDS ENDPOINT

Select, split at 0x00, COBS, CRC, unpack, protobuf, put, log.  No handshake, no commands, no sequence check, no status,
no queue: a slow disk or subscriber stalls it, and every loss is silent.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
import tty
from binascii import crc_hqx
from pathlib import Path

import zenoh
from mcap.writer import Writer

from protocol.bus import board51_pb2 as pb
from protocol.bus.encoding import descriptor_set, zenoh_encoding
from protocol.bus.endpoint import zenoh_config


def cobs(data: bytes) -> bytes:
    """Unstuff, byte by code."""
    out, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        out += data[at + 1 : at + code]
        at += code
        if at < len(data):
            out.append(0)
    return bytes(out)


def state_of(frame: bytes, now: int) -> bytes | None:
    """Decode, convert, serialise; None for anything but a STATE."""
    body = cobs(frame)
    if len(body) != 12 or body[0] != 0x40 or crc_hqx(body, 0xFFFF):
        return None
    sequence = int.from_bytes(body[1:3], "little")
    counts = int.from_bytes(body[3:9], "little")
    return pb.State(
        sequence=sequence, tick=sequence, host_time_ns=now, i_c_a=(counts & 4095) * 2 / 4096,
        x_m=(counts >> 12 & 4095) * 1.43e-6, u_c_v=(counts >> 24 & 4095) * 5 / 4096,
        x_ref_m=(counts >> 36) * 1.43e-6, flags=body[9], t_s=sequence * 2e-3,
    ).SerializeToString()  # fmt: skip


def main(folder: Path, count: int, endpoint: str) -> None:
    """Loop until SIGTERM."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(1))
    session = zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint])))
    stream = (folder / "bare.mcap").open("wb")
    log = Writer(stream)
    log.start()
    schema = log.register_schema("board51.v1.State", "protobuf", descriptor_set())
    ports, pending, publishers, channels = {}, {}, {}, {}
    for number in range(count):
        fd = os.open(folder / f"tty{number}", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(fd)
        key = f"bench/b{number}/state"
        ports[fd], pending[fd] = number, b""
        publishers[fd] = session.declare_publisher(key, encoding=zenoh_encoding(pb.State))
        channels[fd] = log.register_channel(key, "protobuf", schema)
    while not stopped:
        for fd in select.select(list(ports), [], [], 0.2)[0]:
            data = pending[fd] + os.read(fd, 4096)
            now = time.time_ns()
            *frames, pending[fd] = data.split(b"\0")
            for frame in frames:
                state = state_of(frame, now)
                if state is None:
                    continue
                publishers[fd].put(state)
                log.add_message(channels[fd], now, state, now)
    log.finish()
    stream.close()
    session.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
