"""`--quick`: the beginning of each long flight, so that the search passes over less than half of the samples.

Of very many flights it is less of each: the budget of `--quick` pays for a search over `ALL_SAMPLES`, not over more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.estimation.record import Record

FLIGHT_SAMPLES = 2000  # of a closed-loop or open-loop recording: four seconds at 500 Hz
ALL_SAMPLES = 40_000  # of all flights together
_LONG = ("closed-loop", "prbs", "free")


def shortened(records: Sequence[Record]) -> tuple[list[Record], str]:
    """(the recordings, long ones cut; the sentence that says so, empty where nothing was cut)."""
    result, cut = [], 0
    flights = [min(len(record.t), FLIGHT_SAMPLES) for record in records if record.kind in _LONG]
    most = FLIGHT_SAMPLES if sum(flights) <= ALL_SAMPLES else ALL_SAMPLES // len(flights)
    for record in records:
        if record.kind in _LONG and len(record.t) > most:
            retained = slice(0, most)
            cut += 1
            record = replace(
                record,
                t=record.t[retained],
                u_c=record.u_c[retained],
                i_c=record.i_c[retained],
                x=record.x[retained],
                x_ref=record.x_ref[retained],
            )
        result.append(record)
    said = f"--quick: only the first {most} samples of {cut} recordings were used for choosing" if cut else ""
    return result, said
