"""Compile the twin's kernels before the first sample of a board arrives."""

from __future__ import annotations

from protocol.bus import board51_pb2 as pb
from twin.mirror.mirror import Mirror
from twin.model.parameters import Model

_GAINS = (0.5, 1700.0, 18.0, -17600.0)  # of the CE 152, (18); any will do


def compile_kernels(model: Model) -> None:
    """Run a twin of `model` over three made-up samples of a flight.

    The first call on a machine takes about ten seconds, in which a live twin would miss samples; later ones take
    milliseconds, as compiled code is kept (`twin/compiled.py`).
    """
    mirror = Mirror(model)
    x_m, i_a, u_v = 0.5 * model.plant.travel_m, 0.6, 2.0
    mirror.parameters(
        pb.Parameters(
            session=1,
            sample_time_s=2e-3,
            gains=_GAINS,
            i_0_a=i_a,
            x_0_m=x_m,
            u_0_v=u_v,
            x_ref_max_m=model.plant.travel_m,
            u_max_v=5.0,
        )
    )
    for tick in range(1, 4):
        mirror.handle(
            pb.State(
                session=1,
                tick=tick,
                t_s=2e-3 * tick,
                mode=pb.MODE_CLOSED_LOOP,
                i_c_a=i_a,
                x_m=x_m,
                u_c_v=u_v,
                x_ref_m=x_m,
            )
        )
