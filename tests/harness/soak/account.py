"""The account of a soak: where every sample that a board has taken is, once, and why it is not everywhere.

How far a sample came before the gateway is in the emulator's ledger, what the gateway read and kept is in its log, what
it published has the witness.  What is missing must be missing beside a fault that can cost it (`_COSTS`).  The rest is
`unexplained`: there must be none.

A gateway ignores what comes before the end of a handshake.  Its log has the bytes, unless it was killed before they
were on the disk.  The ledger has the handshakes, so that both together explain a sample, and neither alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.harness.soak.faults import Occurrence
from tests.harness.soak.logged import Logged
from tests.harness.soak.numbered_board import Fate, Ledger

Mask = NDArray[np.bool_]

BOTH, LOGGED, PUBLISHED, NOWHERE = "published and logged", "logged", "published", "lost"
DISK_FULL = "disk full for longer than the log's queue holds"
IGNORED = "read, counted in states_ignored"
IGNORED_UNSEEN = "read while the disk was full, counted in states_ignored"
IGNORED_UNCOUNTED = "ignored before the end of a handshake, the gateway killed"
LOG_CUT_NS = 250_000_000  # of log that a kill may cost, gateway/README.md
_BEFORE = {
    Fate.SENSED: "in the board: its queue, a reset",
    Fate.SENT: "on the line: damaged",
    Fate.INTACT: "at the port: nobody reads",
}


@dataclass(frozen=True, slots=True)
class Cost:
    """Samples that a fault may cost, from `before_s` before it began to `after_s` after it ended.

    `is_unbroken`: what comes in order is lost in order, so they are one unbroken run of each board, through the moment
    at which the fault struck, or up to it.  `early`: only such as came before the end of a handshake.
    """

    location: str
    fault: str
    reason: str
    before_s: float
    after_s: float
    is_unbroken: bool = True
    early: bool = False


_COSTS = (
    # A pty holds what its host has not read; it is gone with the pty, or with the host.
    Cost(NOWHERE, "port closed", "in the cable when it was unplugged", 0.5, 0.0),
    # Whoever opens a serial port discards what waits in it (pyserial).
    Cost(NOWHERE, "port opened", "in the cable when the port was opened", 0.0, 0.5),
    # A gateway ignores them; where the log has the bytes, they are seen in it.
    Cost(NOWHERE, "disk full", IGNORED_UNSEEN, 0.5, 1.0, is_unbroken=False, early=True),
    # gateway/README.md: at most 250 ms of log.
    Cost(PUBLISHED, "gateway killed", "not yet on the disk when the gateway was killed", 0.5, 0.1),
    # The log tries again each half second, and finds room for a few between others; it counts what it drops.
    Cost(PUBLISHED, "disk full", DISK_FULL, 0.5, 1.0, is_unbroken=False),
    # Messages wait for the router, as far as the queue holds, which counts what it drops, and while the gateway lives.
    # Not counted is what was on its way when the router died, and what was put before the subscriber was back.
    Cost(LOGGED, "router killed", "no router, or on its way to one that was killed", 0.5, 3.0),
    Cost(LOGGED, "gateway killed", "not yet on the bus when the gateway was killed", 0.5, 0.1),
)


@dataclass(slots=True)
class Account:
    """The account over all boards."""

    sensed: int = 0
    lines: Counter[tuple[str, str]] = field(default_factory=Counter)  # place and reason
    twice: list[tuple[int, int]] = field(default_factory=list)  # board, number: published or logged twice
    invented: list[tuple[int, int]] = field(default_factory=list)  # never sent
    too_early: list[tuple[int, int]] = field(default_factory=list)  # a sample before the end of a handshake
    unexplained: list[tuple[str, int, int, int]] = field(default_factory=list)  # place, board, number, ns
    replayed: int = 0  # under another name; each must be in the log
    read_but_no_sample: Counter[int] = field(default_factory=Counter)  # by board
    counted_no_sample: Counter[int] = field(default_factory=Counter)  # by board, what the gateway says
    counted_dropped: Counter[str] = field(default_factory=Counter)  # what the gateways say: on the bus, in the log

    def table(self) -> str:
        """Return the account as text."""
        rows = [f"{'samples of all boards':<72}{self.sensed:>10}"]
        rows += [f"{f'{location}: {reason}':<72}{n:>10}" for (location, reason), n in sorted(self.lines.items())]
        return "\n".join([*rows, f"{'sum of these':<72}{self.lines.total():>10}"])


def account_of(
    ledgers: Sequence[Ledger],
    published: NDArray[np.int64],
    logs: Mapping[int, Logged],
    happened: Sequence[Occurrence],
    gateways: int,
) -> Account:
    """Put the sources together.

    Args:
        ledgers: Of the boards.
        published: The witness's rows.
        logs: By board.
        happened: The faults.
        gateways: Board n is served by gateway n % gateways; the first one is the one that is killed.

    Returns:
        The account.
    """
    account = Account()
    for board, ledger in enumerate(ledgers):
        count, logged = len(ledger.fate), logs.get(board, Logged())
        at_ns = np.array(ledger.at_ns)
        on_bus = _times(published[published[:, 0] == board, 1], count, board, account)
        in_log = _times(logged.numbers, count, board, account)
        read = np.bincount([n for n in logged.read if n < count], minlength=count)
        known = np.array(ledger.fate) == Fate.RECEIVED
        sampled = (on_bus > 0) | (in_log > 0)
        account.invented += [(board, int(n)) for n in np.flatnonzero(sampled & ~known) if n]
        early = np.array(ledger.early, np.bool_)
        account.too_early += [(board, int(n)) for n in np.flatnonzero(sampled & early)]
        account.sensed += count - 1
        _add_replayed(account, board, published[published[:, 0] == -1 - board, 1], in_log)

        places = {
            BOTH: (on_bus > 0) & (in_log > 0),
            LOGGED: (on_bus == 0) & (in_log > 0),
            PUBLISHED: (on_bus > 0) & (in_log == 0),
            NOWHERE: (on_bus == 0) & (in_log == 0),
        }
        for mask in places.values():
            mask[0] = False
        account.lines[BOTH, "all is well"] += int(places.pop(BOTH).sum())
        concerns = [*_ledger_faults(ledger, board), *(o for o in happened if _concerns(o, board, gateways))]
        _add_ended(account, board, places[NOWHERE], _ended(ledger, read > 0, in_log > 0, concerns))
        made = sampled | places[NOWHERE]
        gaps = {
            NOWHERE: _Gap(known, known & (on_bus == 0) & (in_log == 0) & (read == 0), at_ns),
            PUBLISHED: _Gap(made, in_log == 0, at_ns),
            LOGGED: _Gap(made, on_bus == 0, at_ns),
        }
        causes = {
            location: [(c, gap.cost_of(c, o) & (early | (not c.early))) for c, o in _pairs(location, concerns)]
            for location, gap in gaps.items()
        }
        for location, mask in places.items():
            _explain(account, location, mask, board, at_ns, causes)
        _add_counts(account, board, logged)
    return account


def _ended(ledger: Ledger, read: Mask, in_log: Mask, happened: Sequence[Occurrence]) -> dict[str, Mask]:
    """Return which samples were to come no further, whatever befell bus and log, by the reason."""
    fate, at_ns, early = np.array(ledger.fate), np.array(ledger.at_ns), np.array(ledger.early, np.bool_)
    ended = {reason: fate == before for before, reason in _BEFORE.items()}
    return ended | {IGNORED: read, IGNORED_UNCOUNTED: early & _cut_off(read | in_log, at_ns, happened)}


def _add_ended(account: Account, board: int, lost: Mask, ended: Mapping[str, Mask]) -> None:
    """Move what is lost for these reasons from `lost` to the account."""
    for reason, mask in ended.items():
        explained = lost & mask
        account.lines[NOWHERE, reason] += int(explained.sum())
        if reason == IGNORED:
            account.read_but_no_sample[board] += int(explained.sum())
        lost &= ~explained


def _ledger_faults(ledger: Ledger, board: int) -> list[Occurrence]:
    times = {"port opened": ledger.opened_ns, "port closed": ledger.closed_ns}
    return [Occurrence(name, board, ns, ns, ns) for name, moments in times.items() for ns in moments]


def _times(numbers: NDArray[np.int64], count: int, board: int, account: Account) -> NDArray[np.int64]:
    """Return how often each sample is there."""
    account.invented += [(board, int(n)) for n in numbers[(numbers >= count) | (numbers < 1)]]
    times = np.bincount(numbers[(numbers < count) & (numbers > 0)], minlength=count)
    account.twice += [(board, int(n)) for n in np.flatnonzero(times > 1)]
    return times


def _concerns(occurrence: Occurrence, board: int, gateways: int) -> bool:
    match occurrence.name:
        case "router killed":
            return True
        case "gateway killed":
            return board % gateways == 0
        case "disk full":
            return board % gateways == occurrence.target
        case _:
            return board == occurrence.target


def _cut_off(logged: Mask, at_ns: NDArray[np.int64], happened: Sequence[Occurrence]) -> Mask:
    """Return which samples may have been on their way to the disk when their gateway was killed.

    The log is written in order, so they come after the last one that has reached it.
    """
    mask = np.zeros(len(at_ns), np.bool_)
    for killed in (o for o in happened if o.name == "gateway killed"):
        before = at_ns <= killed.struck_ns
        end = int(np.flatnonzero(logged & before).max(initial=0)) + 1
        mask[end:] |= before[end:] & (at_ns[end:] >= killed.begin_ns - LOG_CUT_NS)
    return mask


class _Gap:
    """The samples of a board that are missing at one location.

    Args:
        reached: Whether each sample came as far as to be able to be there.
        missing: Whether it is not there.
        at_ns: Its time.
    """

    def __init__(self, reached: Mask, missing: Mask, at_ns: NDArray[np.int64]) -> None:
        self._order = np.flatnonzero(reached)
        self._order = self._order[self._order > 0]
        self._at_ns, self._missing = at_ns, missing[self._order]
        self._times_ns = np.maximum.accumulate(at_ns[self._order])  # a frame that came twice has its later time

    def cost_of(self, cost: Cost, occurrence: Occurrence) -> Mask:
        """Return which samples a fault may have cost."""
        window = self._at_ns >= occurrence.begin_ns - cost.before_s * 1e9
        window &= self._at_ns <= occurrence.end_ns + cost.after_s * 1e9
        return window & self._run(occurrence.struck_ns) if cost.is_unbroken else window

    def _run(self, moment_ns: int) -> Mask:
        """Return the unbroken run of missing samples through a moment, or the last one before it."""
        mask = np.zeros(len(self._at_ns), np.bool_)
        first_after = int(np.searchsorted(self._times_ns, moment_ns))
        before = np.flatnonzero(self._missing[: first_after + 1])
        if len(before):
            present = np.flatnonzero(~self._missing)
            at = int(np.searchsorted(present, before[-1]))
            begin = present[at - 1] + 1 if at else 0
            end = present[at] if at < len(present) else len(self._order)
            mask[self._order[begin:end]] = True
        return mask


def _pairs(location: str, happened: Sequence[Occurrence]) -> Iterator[tuple[Cost, Occurrence]]:
    return ((cost, o) for cost in _COSTS for o in happened if (cost.location, cost.fault) == (location, o.name))


def _explain(
    account: Account,
    location: str,
    mask: Mask,
    board: int,
    at_ns: NDArray[np.int64],
    causes: Mapping[str, Sequence[tuple[Cost, Mask]]],
) -> None:
    if location == NOWHERE:
        neither = [np.logical_or.reduce([m for _, m in causes[p]] or [mask & False]) for p in (PUBLISHED, LOGGED)]
        explained = mask & neither[0] & neither[1]
        account.lines[location, "neither on the bus nor on the disk: the gateway killed, or both away"] += int(
            explained.sum()
        )
        mask = mask & ~explained
    for cost, cause in causes[location]:
        explained = mask & cause
        account.lines[location, cost.reason] += int(explained.sum())
        if cost.reason == IGNORED_UNSEEN:
            account.read_but_no_sample[board] += int(explained.sum())
        mask = mask & ~explained
    account.lines[location, "UNEXPLAINED"] += int(mask.sum())
    account.unexplained += [(location, board, int(n), int(at_ns[n])) for n in np.flatnonzero(mask)]


def _add_replayed(account: Account, board: int, ghosts: NDArray[np.int64], in_log: NDArray[np.int64]) -> None:
    account.replayed += len(ghosts)
    account.invented += [(board, int(n)) for n in ghosts if not 0 < n < len(in_log) or not in_log[n]]


def _add_counts(account: Account, board: int, logged: Logged) -> None:
    for status in logged.last:
        account.counted_no_sample[board] += sum(status.states_ignored.values())
        account.counted_dropped["bus"] += status.publish_dropped
    if board < 2:  # one count for all boards of a gateway
        account.counted_dropped["log"] += sum(status.log_dropped for status in logged.last)
