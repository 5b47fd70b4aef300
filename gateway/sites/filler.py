"""Fills the gaps of a recording from the log servers of its site, block by block.

Rule 1: only the records are stored on disk.  Each fill finds the gaps from the folder anew, so one that was killed
        continues where it was, and a second one finds nothing to do.
Rule 2: records younger than `settle_s` are left out, as they may be on their way to the recorder.
Rule 3: memory is bounded: the index of the local parts that overlap the compared time, and one reply.
Rule 4: replies are checked: a record counts only if it belongs to the requested block.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import zenoh
from zenoh.handlers import Handler

from gateway.client.connection import BusBoard
from gateway.record.blocks import LARGEST_REPLY, MAX_IDS, BlockId, decompress, locate, pack
from gateway.record.writer import LogWriter
from gateway.sites.local_log import LocalLog
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.errors import ServiceError

REPLY_S = 30.0
LOOK_S = 0.005
ROTATE_BYTES = 256_000_000
MAX_REPLIES = 200  # about the blocks of a part in a round; no server keeps a fill busy for ever
DAY_NS = 86_400 * 10**9


@dataclass(slots=True)
class Tally:
    """The counts of a round."""

    servers: int = 0
    compared: int = 0  # blocks
    records: int = 0  # filled
    bytes: int = 0
    refused: int = 0  # records that were not asked for, or no records
    settling: int = 0  # servers that have younger blocks, left to the next round


class Filler:
    """Compares and fills; call `fill` again for what is new.

    Args:
        board: The one that is filled, or every board of a site.
        folder: Of the recording; the parts that are filled in are written there, too.
        settle_s: Age from which a block is compared.
        days: Age of the oldest part that is compared.
        report: Called with a line of progress.
        stop: Set it to end a round early.
    """

    def __init__(
        self,
        board: BusBoard,
        folder: Path,
        *,
        settle_s: float = 60.0,
        days: float = 7.0,
        report: Callable[[str], None] = lambda line: None,
        stop: threading.Event | None = None,
    ) -> None:
        self._board, self._folder = board, folder
        self._stop = stop or threading.Event()
        self._settle_ns, self._oldest_ns, self._report = round(settle_s * 1e9), round(days * DAY_NS), report
        self._local = LocalLog(folder)
        # Of server and part: size, and first byte of the next look.
        self._progress: dict[tuple[str, str], tuple[int, int]] = {}
        self._reported: set[str] = set()
        self._writer: LogWriter | None = None

    def fill(self) -> Tally:
        """Make one round through all servers.

        Raises:
            ServiceError: no log server answers, or one went away; the others were filled from.
            LogError: the folder cannot be written.
        """
        tally, failed = Tally(), None
        try:
            for key, reply in self._request(f"{self._board.site}/{topics.LOGS}/*", pb.LogRequest()):
                tally.servers += 1
                try:
                    self._fill_from(key, reply, tally)
                except ServerLostError as error:  # the others are still there
                    failed = error
        finally:
            self._end_part()
        if failed is not None:
            raise failed
        if not tally.servers:
            raise ServiceError(
                f"No log server of {self._board.site} answers",
                remedy="Start `board51 serve-log` beside the gateway's log, and look whether the line to it is up",
            )
        return tally

    def _fill_from(self, key: str, listing: pb.LogReply, tally: Tally) -> None:
        for part in listing.parts:
            size, from_byte = self._progress.get((key, part.name), (0, 0))
            if part.bytes == size or part.changed_ns < listing.now_ns - self._oldest_ns:
                continue
            filled = tally.records
            try:
                next_byte, complete = self._fill_part(key, part.name, from_byte, tally)
            finally:
                if tally.records > filled:
                    # With the server: logs of two sites that began in the same second have the same name.
                    self._report(f"{tally.records - filled} record(s) filled in from {part.name} of {key}")
            self._progress[key, part.name] = (part.bytes if complete else 0, next_byte)
            if not complete:
                tally.settling += 1

    def _fill_part(self, key: str, part: str, from_byte: int, tally: Tally) -> tuple[int, bool]:
        """Fill from one part; return where the next look begins, and whether all of it was old enough."""
        for _ in range(MAX_REPLIES):
            reply = self._request_first(key, pb.LogRequest(part=part, from_byte=from_byte))
            if reply.problem and reply.problem not in self._reported:
                self._reported.add(reply.problem)
                self._report(f"{part} cannot be served as a whole: {reply.problem}")
            if not reply.blocks:
                if reply.more:  # the server has not read so far yet
                    continue
                return from_byte, True
            times_ns = [block.last_ns for block in reply.blocks]
            self._local.look(min(times_ns), max(times_ns))
            for listed in reply.blocks:
                # Not the sign: the clock of that site may have been set back since.
                if abs(reply.now_ns - listed.last_ns) < self._settle_ns:
                    return listed.end_byte, False
                tally.compared += 1
                block = BlockId(listed.stream, listed.session, listed.number)
                if self._is_of_site(block) and self._local.digest(block) != listed.digest:
                    self._fill_block(key, part, block, tally)
            from_byte = reply.blocks[-1].end_byte + 1
            if not reply.more:
                return from_byte, True
        return from_byte, False

    def _fill_block(self, key: str, part: str, block: BlockId, tally: Tally) -> None:
        have, more = self._local.ids(block), True
        request = pb.LogBlock(**block._asdict())
        while more:
            reply = self._request_first(key, pb.LogRequest(part=part, block=request, have=pack(have)[0]))
            before = len(have)
            for record in reply.records:
                located = locate(record)
                if located is None or located.block != block:
                    tally.refused += 1
                elif located.id not in have:
                    have.add(located.id)
                    self._write(record)
                    tally.records += 1
                    tally.bytes += len(record.data)
            if self._writer is not None:
                self._writer.flush()  # records on disk survive a kill
            more = reply.more and before < len(have) < MAX_IDS

    def _is_of_site(self, block: BlockId) -> bool:
        site, _, rest = block.stream.partition("/")
        return site == self._board.site and self._board.board in ("*", rest.partition("/")[0])

    def _write(self, record: pb.LogRecord) -> None:
        if self._writer is not None and self._writer.bytes_written >= ROTATE_BYTES:
            self._end_part()
        if self._writer is None:
            run, number = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()), 0
            while (path := self._folder / f"fill-{run}-{number:03d}.mcap").exists():
                number += 1
            self._writer = LogWriter(path, metadata={"fill": {"site": self._board.site}})
        self._writer.write(record.key, record.data, record.time_ns)

    def _end_part(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            finally:
                writer.abandon()  # records that a full disk does not take are requested again

    def _request(self, key: str, request: pb.LogRequest) -> Iterator[tuple[str, pb.LogReply]]:
        replies = self._board.session.get(
            key, payload=request.SerializeToString(), encoding=zenoh_encoding(pb.LogRequest), timeout=REPLY_S,
            target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE,
        )  # fmt: skip
        for answer in self._arriving(replies):
            if answer.ok is None:
                continue
            reply = parse(pb.LogReply, decompress(answer.ok.payload.to_bytes(), LARGEST_REPLY))
            if reply is not None:
                yield str(answer.ok.key_expr), reply

    def _arriving(self, replies: Handler[zenoh.Reply]) -> Iterator[zenoh.Reply]:
        """Yield the replies until the last; raise ServerLostError at the order to end."""
        while True:
            try:
                answer = replies.try_recv()
            except zenoh.ZError:  # all are there
                return
            if answer is not None:
                yield answer
            elif self._stop.wait(LOOK_S):
                raise ServerLostError("The fill was ended", remedy="The next fill continues where this one stopped")

    def _request_first(self, key: str, request: pb.LogRequest) -> pb.LogReply:
        for _, reply in self._request(key, request):
            return reply
        raise ServerLostError(
            f"The log server {key} does not answer any more", remedy="The next fill continues where this one stopped"
        )


class ServerLostError(ServiceError):
    """A server, or the line to it, went away in the middle of a round."""
