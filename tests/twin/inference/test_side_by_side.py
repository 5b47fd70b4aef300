"""Climbs side by side: as many as there are workers, and the same results."""

from __future__ import annotations

import threading

from tests.harness.diagnose.simulated_rig import PLANT, THETA, TICK_S, narrow
from twin.evidence.gather import gather
from twin.inference.likelihood import Criterion


def test_climbs_run_side_by_side_and_keep_their_order() -> None:
    """Both wait for each other: one after the other they would wait for ever.  Each asks for derivatives meanwhile."""
    criterion = Criterion(gather(narrow(THETA, seconds=2.0), PLANT), PLANT, TICK_S, workers=2)
    together = threading.Barrier(2, timeout=60.0)

    def work(size: float) -> float:
        together.wait()
        return criterion.values([THETA.having("K_c", size)])[0]

    sizes = [5.5e-6, 5.6e-6, 5.7e-6, 5.8e-6]
    values = criterion.each(work, sizes)
    criterion.close()

    serial = Criterion(criterion.evidence, PLANT, TICK_S, workers=1)
    assert values == serial.each(lambda size: serial.value(THETA.having("K_c", size)), sizes)
    serial.close()
