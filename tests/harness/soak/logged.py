"""The contents of a gateway's log: samples, the STATE frames in the bytes it read, and the last counts of each run."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from protocol.bus import board51_pb2 as pb
from protocol.log.reader import LogReader
from protocol.wire.decoder import State, StreamDecoder
from tests.harness.soak.numbered_board import number_of, numbers_of


@dataclass(slots=True)
class Logged:
    """The log of one board."""

    samples: list[tuple[float, float]] = field(default_factory=list)  # i_c in A, x in m
    read: list[int] = field(default_factory=list)  # numbers of the STATE frames in the bytes from the board
    steps: int = 0  # of the wall clock, as the gateway reports them
    sessions: Counter[int] = field(default_factory=Counter)  # in how many runs of the gateway each number was used
    backwards: int = 0  # samples whose time is before that of the sample before them, in one session
    last: list[pb.Status] = field(default_factory=list)  # the last one of each run of the gateway

    @property
    def numbers(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """The numbers of the samples."""
        i_c_a, x_m = np.array(self.samples, np.float64).reshape(-1, 2).T
        return numbers_of(i_c_a, x_m)


def read_logs(parts: Sequence[Path]) -> dict[int, Logged]:
    """Read the parts of one gateway's log, which may have been killed many times; by the number of the board."""
    logs: dict[int, Logged] = defaultdict(Logged)
    for _, run in groupby(parts, lambda path: path.stem.rsplit("-", 1)[0]):
        decoders: dict[str, StreamDecoder] = {}
        last: dict[int, pb.Status] = {}
        newest: dict[tuple[int, int], int] = {}  # board, session -> time
        for record in LogReader(list(run)).raw(topics_=["state", "status", "event", "raw"]):
            if not record.board.startswith("rig"):
                continue
            logged = logs[number := int(record.board.removeprefix("rig"))]
            if record.topic == "state":
                state = pb.State.FromString(record.data)
                logged.samples.append((state.i_c_a, state.x_m))
                before_ns, newest[number, state.session] = newest.get((number, state.session), 0), state.host_time_ns
                logged.backwards += state.host_time_ns < before_ns
            elif record.topic == "status":
                last[number] = pb.Status.FromString(record.data)
            elif record.topic == "event":
                name = pb.Event.FromString(record.data).name
                logged.steps += name == "clock-stepped"
                if name == "port-opened":
                    decoders[record.board] = StreamDecoder()  # as the session does
            elif not (raw := pb.RawBytes.FromString(record.data)).to_board:
                events = decoders.setdefault(record.board, StreamDecoder()).feed(raw.data)
                logged.read += [number_of(event.i_c, event.x) for event in events if isinstance(event, State)]
        for number, session in newest:
            logs[number].sessions[session] += 1
        for number, status in last.items():
            logs[number].last.append(status)
    return logs
