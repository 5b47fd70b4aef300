"""Data from a rig: one sample, samples as arrays, a capture, a reply.  SI units.

numpy is imported only for arrays; commands and single samples work without it (extras of pyproject.toml).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from gateway.client.commands import Mode
from protocol.bus import board51_pb2 as pb
from protocol.errors import DataError, UsageError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]
    IntArray = npt.NDArray[np.int64]

_MODES = {pb.MODE_IDLE: Mode.IDLE, pb.MODE_OPEN_LOOP: Mode.OPEN_LOOP, pb.MODE_CLOSED_LOOP: Mode.CLOSED_LOOP}
_MEASURED = ("i_c_a", "x_m", "u_c_v", "x_ref_m")
_LAST_TICK = (1 << 63) - 1  # the arrays hold no larger one


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The reply to an accepted command."""

    id: str  # of the command
    tick: int  # of the board, from which the command is in force
    text: str  # a remark; mostly empty
    attempts: int  # frames sent to the board

    @classmethod
    def of(cls, reply: pb.CommandReply) -> Self:
        """Return the values of a message of the bus."""
        return cls(id=reply.id, tick=reply.tick, text=reply.text, attempts=reply.attempts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A sample of the board.  A quantity that was not measured is NaN."""

    tick: int  # control periods since the board's reset: the time base; strictly increasing within a session
    session: int  # a new number after each reset or reconnection: nothing is continuous across it
    t_s: float  # time on the board's clock, s
    i_c_a: float  # coil current, A
    x_m: float  # position of the ball, m, up from the sensor
    u_c_v: float  # input in force from this tick to the next, V
    x_ref_m: float  # reference in force at this tick, m
    mode: Mode
    flags: int  # bits of protocol.wire.messages.Flag
    lost_before: int  # samples missing directly before this one

    @classmethod
    def of(cls, state: pb.State) -> Self:
        """Return the values of a message of the bus.

        Raises:
            DataError: no sample of this version has its mode or tick.
        """
        mode = _MODES.get(state.mode)
        if mode is None or state.tick > _LAST_TICK:
            what = f"mode {state.mode}" if mode is None else f"tick {state.tick}"
            problem = f"A sample of session {state.session} has the {what}, which this version does not know"
            raise DataError(problem, remedy="Install the same version as that of the gateway")
        measured = {name: getattr(state, name) if state.HasField(name) else math.nan for name in _MEASURED}
        return cls(
            tick=state.tick,
            session=state.session,
            t_s=state.t_s,
            **measured,
            mode=mode,
            flags=state.flags,
            lost_before=state.lost_before,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Samples: one array for each quantity, all of shape (n,).  A quantity that was not measured is NaN."""

    tick: IntArray  # control periods since the board's reset, shape (n,)
    session: IntArray  # a new number after a reset or reconnection: nothing is continuous there, shape (n,)
    t_s: FloatArray  # time on the board's clock, s, shape (n,)
    i_c_a: FloatArray  # coil current, A, shape (n,)
    x_m: FloatArray  # position of the ball, m, up from the sensor, shape (n,)
    u_c_v: FloatArray  # input in force from this tick to the next, V, shape (n,)
    x_ref_m: FloatArray  # reference, m, shape (n,)
    mode: npt.NDArray[np.str_]  # "idle", "open-loop" or "closed-loop", shape (n,)
    flags: IntArray  # bits of protocol.wire.messages.Flag, shape (n,)
    lost_before: IntArray  # samples missing directly before each one, shape (n,)

    def __len__(self) -> int:
        return len(self.tick)

    @classmethod
    def of(cls, samples: Iterable[Sample]) -> Self:
        """Make arrays from samples, in their order."""
        import numpy as np

        rows = list(samples)
        kinds: dict[str, Any] = {"tick": np.int64, "session": np.int64, "flags": np.int64, "lost_before": np.int64}
        kinds["mode"] = np.str_
        return cls(
            **{
                f.name: np.array([getattr(row, f.name) for row in rows], dtype=kinds.get(f.name, np.float64))
                for f in fields(cls)
            }
        )

    def to_dict(self) -> dict[str, npt.NDArray[Any]]:
        """The arrays by name, each of shape (n,)."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def to_dataframe(self) -> Any:
        """A pandas DataFrame with one column for each quantity.

        Raises:
            UsageError: pandas is not installed; it is not a dependency of board51.
        """
        try:
            import pandas  # optional, not among our dependencies
        except ImportError:
            problem = "pandas is not installed, and a DataFrame needs it"
            raise UsageError(problem, remedy="Install pandas, or use the arrays: to_dict() has them by name") from None
        return pandas.DataFrame(self.to_dict())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Capture:
    """The coil current around a step of the input, at 25 kHz."""

    session: int
    tick: int  # at the beginning of the capture
    sample_time_s: float
    u_from_v: float
    u_to_v: float
    t_s: FloatArray  # time from the step, s, shape (n,)
    i_c_a: FloatArray  # coil current, A, shape (n,)

    @classmethod
    def of(cls, record: pb.CaptureRecord) -> Self:
        """Return the values of a message of the bus."""
        import numpy as np

        return cls(
            session=record.session,
            tick=record.tick,
            sample_time_s=record.sample_time_s,
            u_from_v=record.u_from_v,
            u_to_v=record.u_to_v,
            t_s=np.asarray((np.arange(len(record.i_c_a)) - record.step_index) * record.sample_time_s, dtype=np.float64),
            i_c_a=np.array(record.i_c_a, dtype=np.float64),
        )


def read_log(path: Path | str | Sequence[Path], *, board: str | None = None) -> Samples:
    """Read the samples of one board from an MCAP log.

    Args:
        path: An MCAP file, or the files of one log.
        board: Its name; None if the log has only one board.

    Returns:
        Arrays of shape (n,), SI units.

    Raises:
        DataError: the file is not a board51 log, is damaged, has samples of another version, does not have this
            board, or has several boards and `board` is None.
    """
    from protocol.log.reader import read

    where = Path(path) if isinstance(path, str) else path
    rows, boards = [], set()
    for record in read(where, ["state"], [board] if board else None):
        assert isinstance(record.message, pb.State)
        boards.add(record.board)
        try:
            rows.append(Sample.of(record.message))
        except DataError as error:
            raise DataError(f"{path}: {error.problem}", remedy=error.remedy) from None
    if len(boards) > 1:
        raise DataError(f"{path} has the boards {', '.join(sorted(boards))}", remedy="Name one of them: board=...")
    if not rows:
        raise DataError(f"{path} has no samples" + (f" of {board}" if board else ""), remedy="See `board51 info`")
    return Samples.of(rows)
