"""`--quick`: only the beginning of each long flight is used, typically less than half of the samples.

With very many flights each is shorter, as the budget of `--quick` covers a search over `ALL_SAMPLES`.
"""

from __future__ import annotations

from collections.abc import Sequence

from twin.estimation.record import Record

FLIGHT_SAMPLES = 2000  # of a closed-loop or open-loop recording: four seconds at 500 Hz
ALL_SAMPLES = 40_000  # of all flights together
_LONG = ("closed-loop", "prbs", "free")


def shortened(records: Sequence[Record]) -> tuple[list[Record], str]:
    """Return (the recordings, long ones shortened; a sentence about it, empty if none was shortened)."""
    result, cut = [], 0
    flights = [min(len(record.t), FLIGHT_SAMPLES) for record in records if record.kind in _LONG]
    # Less of each flight, not fewer flights: recordings differ more from one another than their parts do.
    max_samples = FLIGHT_SAMPLES if sum(flights) <= ALL_SAMPLES else ALL_SAMPLES // len(flights)
    for record in records:
        if record.kind in _LONG and len(record.t) > max_samples:
            cut += 1
            record = record.part(slice(0, max_samples))
        result.append(record)
    sentence = (
        f"--quick: only the first {max_samples} samples of {cut} recordings were used for selection" if cut else ""
    )
    return result, sentence
