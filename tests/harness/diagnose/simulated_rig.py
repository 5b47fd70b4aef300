"""A CE 152 as a theta, its board's law, and short recordings of it: for tests of what the diagnosis computes."""

from __future__ import annotations

import numpy as np

from protocol.campaign import Controller, OperatingPoint, Plant
from protocol.experiments import Experiment
from twin.diagnosis.experiments.closed_loop import Rig
from twin.diagnosis.experiments.designed_law import lift_off_input
from twin.diagnosis.experiments.schedules import MENU, schedule_of
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.search.score_test import probed
from twin.diagnosis.search.task import Search
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.inference.fisher_scoring import Fit, climb
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import floor_of
from twin.inference.theta import BASE, Theta, coordinates_of
from twin.model.causes.catalogue import BY_NAME
from twin.model.causes.cause import Cause
from twin.model.equilibrium import at_rest
from twin.settings import diagnosis as settings

PLANT = Plant(name="ce152", mass_kg=8.28e-3, travel_m=5.7e-3, x_max_m=8.1e-3, gravity_m_s2=9.81)
THETA = Theta(
    K_A=0.3,
    T_A=4e-4,
    K_c=5.6e-6,
    b=0.02,
    sigma_i_c_a=2e-3,
    sigma_x_m=5e-6,
    process_i_c_a=1e-5,
    process_a_m_s2=0.005,
)
MIDDLE_M = 2.85e-3
TICK_S = 2e-3
ITEMS = {item.name: item for item in MENU}


def controller(theta: Theta = THETA) -> Controller:
    """The emulated board's gains, at the operating point of this rig."""
    y, u_0 = at_rest(theta.base(PLANT), theta.vector(), MIDDLE_M)
    return Controller(
        kind="lqi",
        gains=(0.49, 1700.0, 17.7, -17600.0),
        operating_point=OperatingPoint(i_c_a=float(y[0]), x_m=MIDDLE_M, u_c_v=u_0),
    )


def rig_of(theta: Theta) -> Rig:
    """The rig and the emulated board's law."""
    return Rig(theta=theta, plant=PLANT, controller=controller())


def strong(cause: str, value: float, theta: Theta = THETA) -> Theta:
    """The rig with that strength of a cause."""
    return probed(theta, BY_NAME[cause], value)


def made(item: Experiment, theta: Theta, *, seed: int = 3) -> list[Record]:
    """An experiment of the menu, as short as it is computed."""
    schedule, _ = schedule_of(item, lift_off_v=lift_off_input(theta, PLANT), travel_m=PLANT.travel_m, tick_s=TICK_S)
    return simulate(rig_of(theta), schedule, seed=seed)


def narrow(theta: Theta, *, seed: int = 1, seconds: float = 6.0) -> list[Record]:
    """25 kHz steps and small reference steps, nothing else."""
    t = np.arange(round(seconds / TICK_S)) * TICK_S
    steps = Schedule(
        name="steps",
        kind="closed-loop",
        command=MIDDLE_M + np.where(t % 1.0 < 0.5, 0.4e-3, -0.4e-3),
        closed_loop=True,
    )
    bursts = Schedule(name="bursts", kind="amplifier-step", command=np.empty(0), bursts=((0.3, 1.5), (1.5, 2.5)))
    return [
        *simulate(rig_of(theta), bursts, seed=seed),
        *simulate(rig_of(theta), steps, seed=seed + 1),
    ]


def criterion_of(records: list[Record], plant: Plant = PLANT) -> Criterion:
    return Criterion(gather(records, plant), plant, TICK_S, workers=1)


def fitted(criterion: Criterion, start: Theta, *causes: str) -> Fit:
    """The maximum with these causes, from that start."""
    free = BASE + tuple(name for cause in causes for name in coordinates_of(cause))
    return climb(criterion, start, free)


def trusting(criterion: Criterion, base: Fit, candidate: Cause) -> Search:
    """A search for one candidate that takes the selected causes as right: it asks for another share than usual."""
    floor, share = floor_of(criterion, base.theta), 0.5 * settings.MIN_SHARE
    return Search(criterion=criterion, floor=floor, candidates=(candidate,), max_candidates=3, min_share=share)
