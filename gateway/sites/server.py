"""Serves the records in the log of a site: the queryable `<site>/_logs/<id of this session>`.

Rule 1: every request is complete in itself; indexes retained between requests only save time.
Rule 2: memory is bounded: MAX_PARTS indexes of parts, the records of one block, and replies of REPLY_BYTES.  These are
        small: on a slow line the samples wait behind a reply in the router's queue, and must not be dropped.
Rule 3: a request that cannot be served gets a reply that says why.  Of a damaged part everything intact is served.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path

import zenoh
import zstandard
from zenoh.handlers import RingChannel

from gateway.record.blocks import BlockId, unpack
from gateway.record.contents import Contents
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.bus.encoding import parse, zenoh_encoding
from protocol.errors import DataError
from protocol.log.reader import RawLogRecord

MAX_PARTS = 8
MAX_BLOCKS = 2000  # of a reply
REPLY_BYTES = 1 << 18  # of records, before they are packed
LOOK_S = 0.1  # longest wait for a query
SOON_S = 0.001
LOOK_FOR_S = 5.0  # into a part, before there is a reply
_QUERIES = 16  # that may wait; the asker of an older one asks again

_logger = logging.getLogger("gateway.sites")


class LogServer:
    """The answers from a folder of logs; `serve` puts them on the bus.

    Args:
        folder: Of the parts, finished or being written.
        site: Of the keys that are served.
    """

    def __init__(self, folder: Path, site: str) -> None:
        self._folder, self._site = folder, site
        self._contents: OrderedDict[str, Contents] = OrderedDict()
        self._complete = True  # whether the part was read to its end
        self._reported = ""
        self._block: tuple[tuple[str, BlockId, int], list[tuple[int, RawLogRecord]]] | None = None

    def answer(self, payload: bytes) -> pb.LogReply:
        """Return the reply to a serialised LogRequest."""
        request, reply = parse(pb.LogRequest, payload), pb.LogReply(now_ns=time.time_ns())
        if request is None:
            reply.problem = "The request is malformed: install the same version at both sites."
            return reply
        try:
            if not request.part:
                reply.parts.extend(self._parts())
                return reply
            contents = self._opened(request.part)
            if request.HasField("block"):
                self._add_records(reply, contents, request)
            else:
                self._add_blocks(reply, contents, request.from_byte)
        except (DataError, OSError) as error:
            reply.problem = str(error)
        return reply

    def serve(self, session: zenoh.Session, stop: threading.Event) -> None:
        """Answer the queries of a session until `stop` is set."""
        key = f"{self._site}/{topics.LOGS}/{session.info.zid()}"
        queryable = session.declare_queryable(key, RingChannel(_QUERIES))
        wait_s = LOOK_S
        while not stop.wait(wait_s):
            query = queryable.try_recv()
            if query is None:
                wait_s = min(2.0 * wait_s, LOOK_S)
                continue
            wait_s = SOON_S  # the next request follows the reply
            with query:
                reply = self.answer(query.payload.to_bytes() if query.payload is not None else b"")
                if reply.problem and reply.problem != self._reported:
                    self._reported = reply.problem
                    _logger.warning("%s", reply.problem)
                packed = zstandard.ZstdCompressor().compress(reply.SerializeToString())
                with suppress(zenoh.ZError):  # the asker has gone
                    query.reply(key, packed, encoding=zenoh_encoding(pb.LogReply))

    def _parts(self) -> list[pb.LogPart]:
        parts = []
        for path in self._folder.glob("*.mcap"):
            try:
                status = path.stat()
            except OSError:  # deleted meanwhile
                continue
            if status.st_size:
                parts.append(pb.LogPart(name=path.name, bytes=status.st_size, changed_ns=status.st_mtime_ns))
        return sorted(parts, key=lambda part: (part.changed_ns, part.name))

    def _opened(self, name: str) -> Contents:
        """Return the contents of a part as it is now; raises DataError if there is no such part."""
        if all(part.name != name for part in self._parts()):  # a name from the network is never part of a path
            raise DataError(f"The log has no part {name}", remedy="Ask for the parts again")
        contents = self._contents.get(name) or Contents(self._folder / name)
        self._contents[name] = contents
        self._contents.move_to_end(name)
        if len(self._contents) > MAX_PARTS:
            self._contents.popitem(last=False)
        self._complete = contents.refresh(LOOK_FOR_S)
        return contents

    def _add_blocks(self, reply: pb.LogReply, contents: Contents, from_byte: int) -> None:
        blocks = sorted((entry.end_byte, block) for block, entry in contents.blocks.items() if self._serves(block))
        for end_byte, block in blocks:
            if end_byte < from_byte:
                continue
            # Those that end in the same chunk come together: the next request begins behind it.
            if len(reply.blocks) >= MAX_BLOCKS and end_byte != reply.blocks[-1].end_byte:
                reply.more = True
                return
            entry = contents.blocks[block]
            where, what = block._asdict(), {"count": entry.count, "digest": entry.digest, "last_ns": entry.last_ns}
            reply.blocks.add(**where, **what, end_byte=end_byte)
        reply.more, reply.problem = not self._complete, contents.damage

    def _add_records(self, reply: pb.LogReply, contents: Contents, request: pb.LogRequest) -> None:
        block = BlockId(request.block.stream, request.block.session, request.block.number)
        entry, have = contents.blocks.get(block), unpack(request.have)
        if entry is None or not self._serves(block):
            raise DataError(
                f"{contents.path.name} has no block {block.number} of {block.stream}, session {block.session}",
                remedy="Ask for the blocks again",
            )
        version = (contents.path.name, block, entry.digest)
        if self._block is None or self._block[0] != version:
            self._block = (version, list(contents.records(block)))
        size = 0
        for number, record in self._block[1]:
            if number in have:
                continue
            if size >= REPLY_BYTES:
                reply.more = True
                return
            reply.records.add(key=record.key, time_ns=record.time_ns, data=record.data)
            size += len(record.data)

    def _serves(self, block: BlockId) -> bool:
        return block.stream.startswith(f"{self._site}/")
