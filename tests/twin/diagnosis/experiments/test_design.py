from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gateway.emulator.firmware_model.flash import POSITION
from gateway.emulator.plant.constants import CE152, PlantConstants
from protocol.campaign import Controller, OperatingPoint, Plant
from protocol.experiments import Experiment, Wave
from protocol.wire.messages import Shape
from tests.harness.diagnose.simulated_rig import (
    ITEMS,
    MIDDLE_M,
    PLANT,
    THETA,
    TICK_S,
    controller,
    criterion_of,
    fitted,
    made,
    narrow,
    strong,
)
from tests.harness.twin.emulated_campaign import Lab
from twin.diagnosis.experiments import design as experiments
from twin.diagnosis.experiments.design import ENOUGH_Z, Proposal, propose
from twin.diagnosis.experiments.schedules import MENU, schedule_of, sentence
from twin.diagnosis.search.candidate_fits import Trial
from twin.estimation.record import Record
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.theta import moved
from twin.model.causes.catalogue import CATALOGUE, measurement_for
from twin.model.causes.cause import Cause

GAP, EXPONENT = "air-gap-offset", "force-exponent"


def as_trial(cause: str, fit: Fit, at: Fit) -> Trial:
    return Trial(cause=cause, fit=fit, gain=fit.loglik - at.loglik)


def z_of(correct: Fit, confounder: Fit) -> float:
    """Return by how much the data prefer the model that made them."""
    lead = correct.loglik - confounder.loglik
    return math.copysign(math.sqrt(2.0 * abs(lead)), lead)


@pytest.fixture(scope="module")
def gap_or_exponent() -> tuple[list[Record], Criterion, Fit, Fit, list[Proposal]]:
    """A narrow campaign of a rig whose coil sits higher, both explanations fitted, and what is proposed."""
    theta = strong(GAP, 2.5e-4)
    records = narrow(theta, seconds=4.0)
    criterion = criterion_of(records)
    correct, confounder = fitted(criterion, theta, GAP), fitted(criterion, strong(EXPONENT, 1.9), EXPONENT)
    return (
        records,
        criterion,
        correct,
        confounder,
        propose(criterion, correct, GAP, [as_trial(EXPONENT, confounder, correct)], controller()),
    )


@pytest.mark.parametrize("item", MENU, ids=lambda item: item.name)
def test_what_is_commanded_stays_in_its_range_and_is_said_in_numbers(item: Experiment) -> None:
    schedule, times = schedule_of(item, lift_off_v=3.0, travel_m=5.7e-3, tick_s=TICK_S)
    text = sentence(item, lift_off_v=3.0, travel_m=5.7e-3)

    unit = 5.7e-3 if item.closed_loop else 3.0
    ends = [
        end for part in item.signals for end in ((part.low, part.high) if isinstance(part, Wave) else (part.value,))
    ]
    if len(schedule.command):
        assert min(ends) * unit - 1e-12 <= schedule.command.min()
        assert schedule.command.max() <= max(ends) * unit + 1e-12
        assert len(schedule.command) * TICK_S * times == pytest.approx(
            sum(part.duration_s for part in item.signals), rel=0.01
        )
    assert "{" not in text
    assert ("mm" if item.closed_loop else " V") in text or item.name == "rest"


def test_force_laws_are_told_apart_by_wide_motion(
    gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]],
) -> None:
    _, _, correct, confounder, proposals = gap_or_exponent
    z = {proposal.name: proposal.separation_z for proposal in proposals}

    assert abs(z_of(correct, confounder)) < ENOUGH_Z  # the campaign so far cannot
    # A power that may bend imitates a shifted pole but for the whole travel.
    assert z["holds"] > 3.0 * max(z["steps"], ENOUGH_Z)
    assert min(z["wide-steps"], z["slow-ramp"]) > z["steps"]
    assert max(z["rest"], z["amplifier-steps"], z["blocked-ball"]) < ENOUGH_Z  # the amplifier alone
    assert [proposal.separation_z for proposal in proposals] == sorted(z.values(), reverse=True)
    assert proposals[0].separable
    assert not proposals[-1].separable
    assert proposals[0].command == f"board51 campaign run FOLDER --experiment {proposals[0].name}"
    assert "warm-run" not in z  # nothing here heats


@pytest.mark.parametrize(
    "name",
    [
        "steps",
        "lift-off",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("prbs-reference", "multisine", "wide-steps")),
    ],
)
def test_the_separation_is_what_a_refit_with_the_experiment_finds(
    name: str, gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]]
) -> None:
    records, _, correct, confounder, proposals = gap_or_exponent
    predicted = next(proposal.separation_z for proposal in proposals if proposal.name == name)
    item = ITEMS[name]
    whole = replace(item, stationary=False)

    with_it = criterion_of([*records, *made(whole, correct.theta, seed=11)])
    actual_z = z_of(fitted(with_it, correct.theta, GAP), fitted(with_it, confounder.theta, EXPONENT))

    # z has a standard error of 1.  A clear misfit is partly taken for process noise, which the prediction does not do.
    assert actual_z > 0.35 * predicted - 3.0
    assert actual_z < 1.25 * predicted + 3.0


def test_what_the_campaign_leaves_open_is_not_taken_for_a_difference(
    gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]],
) -> None:
    _, criterion, correct, _, _ = gap_or_exponent
    errors, index = 3.0, correct.free.index(f"{GAP}.d_m")
    shift = correct.covariance[:, index] / math.sqrt(correct.covariance[index, index])  # the others follow, as in a fit
    theta = correct.theta
    for name, component in zip(correct.free, shift, strict=True):
        theta = moved(theta, name, errors * float(component), PLANT)
    same = replace(correct, theta=theta)

    proposals = propose(criterion, correct, GAP, [as_trial(GAP, same, correct)], controller())

    # Tied down by F_c, told by F_e: z^2 = errors^2 F_e / (F_c + F_e) < errors^2, a tenth for the noise levels.
    assert max(proposal.separation_z for proposal in proposals) < 1.1 * errors
    assert max(proposal.separation_z for proposal in proposals) > 0.5 * errors


def test_an_experiment_four_times_as_long_tells_more_but_not_more_than_four(
    gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, criterion, correct, confounder, _ = gap_or_exponent
    steps = Wave(shape="rectangle", low=0.27, high=0.73, period_s=1.4, duration_s=4.2, on_reference=True)
    short = Experiment(name="wide-steps", kind="closed-loop", use="fit", purpose="", expects="flies", steps=(steps,))
    long = replace(short, name="longer", steps=(replace(steps, duration_s=16.8),))
    monkeypatch.setattr(experiments, "MENU", (short, long))

    proposals = propose(criterion, correct, GAP, [as_trial(EXPONENT, confounder, correct)], controller())

    squares = {proposal.name: proposal.separation_z**2 - proposal.pairs[0].now_z ** 2 for proposal in proposals}
    # Less than four: what the campaign ties down ties both.
    assert 1.5 < squares["longer"] / squares["wide-steps"] < 4.1


@pytest.fixture(scope="module")
def delay_case() -> tuple[Criterion, Fit, Trial]:
    """A rig whose input acts late; the fit of that, and of samples that are late."""
    truth = strong("actuation-delay", 6e-4)
    criterion = criterion_of(narrow(truth, seconds=2.0))
    correct = fitted(criterion, truth, "actuation-delay")
    samples = fitted(criterion, strong("sampling-delay", 6e-4), "sampling-delay")
    return criterion, correct, as_trial("sampling-delay", samples, correct)


def test_causes_of_one_effect_are_not_separable_and_the_measurement_that_does_it_is_named(
    delay_case: tuple[Criterion, Fit, Trial],
) -> None:
    criterion, correct, samples = delay_case

    proposals = propose(criterion, correct, "actuation-delay", [samples], controller())

    assert proposals
    for proposal in proposals:
        assert proposal.separation_z < 0.5
        assert not proposal.separable
        (pair,) = proposal.pairs
        assert not pair.separable
        assert "oscilloscope" in pair.measurement


@pytest.mark.slow
def test_with_several_confounders_the_hopeless_pair_does_not_hide_what_the_others_need(
    delay_case: tuple[Criterion, Fit, Trial],
) -> None:
    criterion, correct, samples = delay_case
    lag = as_trial("eddy-current-lag", fitted(criterion, strong("eddy-current-lag", 6e-4), "eddy-current-lag"), correct)

    proposals = propose(criterion, correct, "actuation-delay", [samples, lag], controller())

    delay, eddy = proposals[0].pairs
    assert (delay.confounder, delay.separable) == ("sampling-delay", False)
    assert (eddy.confounder, eddy.separable, eddy.measurement) == ("eddy-current-lag", True, "")
    assert proposals[0].separable
    assert proposals[0].separation_z == eddy.separation_z > ENOUGH_Z


def test_nothing_is_proposed_without_a_confounder(
    gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]],
) -> None:
    _, criterion, correct, _, _ = gap_or_exponent

    assert propose(criterion, correct, GAP, [], controller()) == []


def test_a_loop_that_drops_the_ball_is_not_proposed(
    gap_or_exponent: tuple[list[Record], Criterion, Fit, Fit, list[Proposal]],
) -> None:
    _, criterion, correct, confounder, _ = gap_or_exponent
    weak = replace(controller(), gains=(0.0, 100.0, 1.0, -10.0))

    proposals = propose(criterion, correct, GAP, [as_trial(EXPONENT, confounder, correct)], weak)

    assert proposals
    assert not any(ITEMS[proposal.name].closed_loop for proposal in proposals)


@pytest.mark.slow
def test_a_coil_that_heats_is_asked_to_get_warm() -> None:
    truth = strong("amplifier-gain-drift", 0.03)
    criterion = criterion_of(narrow(truth, seconds=1.5))
    correct = fitted(criterion, truth, "amplifier-gain-drift")
    confounder = fitted(criterion, strong("amplifier-dead-zone", 0.05), "amplifier-dead-zone")

    proposals = propose(
        criterion, correct, "amplifier-gain-drift", [as_trial("amplifier-dead-zone", confounder, correct)], controller()
    )

    assert "warm-run" in {proposal.name for proposal in proposals}


@pytest.mark.parametrize("cause", CATALOGUE, ids=lambda cause: cause.name)
def test_a_measurement_is_known_for_every_pair(cause: Cause) -> None:
    for other in CATALOGUE:
        assert len(measurement_for(cause.name, other.name)) > 20


# From here on the recordings come from the emulated board, whose physics and firmware are not the twin's.


class Bench:
    """An emulated board with a rig whose coil sits higher than its model knows."""

    def __init__(self, *, gap_m: float, seed: int) -> None:
        self.rig = replace(CE152, coil_plane_above_stop_m=2.4e-3)
        self.lab = Lab(self.rig, effects={GAP: gap_m}, seed=seed)
        self.plant = Plant(
            name="ce152", mass_kg=self.rig.mass_kg, travel_m=self.rig.travel_m,
            x_max_m=self.rig.travel_m + self.rig.coil_plane_above_stop_m, gravity_m_s2=9.81,
        )  # fmt: skip
        self.controller = _gains_of(self.rig)
        self.x_ref_m = MIDDLE_M

    def narrow(self) -> list[Record]:
        self.lab.request("SET_MODE", mode=1)
        captures = tuple(self.lab.capture(a, b) for a, b in ((0.3, 1.5), (1.5, 2.5)))
        empty = np.empty(0)
        bursts = Record(
            name="bursts", kind="amplifier-step", use="fit", t=empty, u_c=empty, i_c=empty, x=empty, x_ref=empty,
            captures=captures,
        )  # fmt: skip
        self.lab.request("SET_MODE", mode=0)
        self.lab.fly(MIDDLE_M)
        self.lab.run(300)
        self._excite(Wave(shape="rectangle", low=0.44, high=0.56, period_s=1.0, duration_s=4.0))
        return [bursts, self.lab.record("narrow", "closed-loop", 2000)]

    def perform(self, item: Experiment) -> Record:
        """An experiment of the menu on the reference, part by part."""
        pieces = []
        for part in item.signals:
            if isinstance(part, Wave):
                self._excite(part)
            else:
                self._go_to(part.value * self.rig.travel_m)
            pieces.append(self.lab.record(item.name, "closed-loop", round(part.duration_s / TICK_S)))
        return Record(
            name=item.name,
            kind="closed-loop",
            use="fit",
            t=np.concatenate([piece.t for piece in pieces]),
            u_c=np.concatenate([piece.u_c for piece in pieces]),
            i_c=np.concatenate([piece.i_c for piece in pieces]),
            x=np.concatenate([piece.x for piece in pieces]),
            x_ref=np.concatenate([piece.x_ref for piece in pieces]),
        )

    def _go_to(self, x_m: float) -> None:
        """Move the reference to `x_m` in steps as large as the board allows."""
        while abs(x_m - self.x_ref_m) > 1e-9:
            self.x_ref_m += min(max(x_m - self.x_ref_m, -0.6e-3), 0.6e-3)
            self.lab.request("SET_REFERENCE", x_ref=POSITION.to_count(self.x_ref_m))
            self.lab.run(20)

    def _excite(self, wave: Wave) -> None:
        low, high = wave.low * self.rig.travel_m, wave.high * self.rig.travel_m
        self._go_to((low + high) / 2.0)
        self.lab.excite(
            Shape[wave.shape.upper()],
            on_reference=True,
            amplitude=min(POSITION.span((high - low) / 2.0), POSITION.span(1.25e-3)),
            offset=POSITION.to_count((low + high) / 2.0),
            period=round(wave.period_s / TICK_S),
            seed=5,
        )


def _gains_of(rig: PlantConstants) -> Controller:
    i_0, u_0 = rig.equilibrium_current_a(MIDDLE_M), rig.equilibrium_input_v(MIDDLE_M)
    gain = CE152.equilibrium_current_a(MIDDLE_M) / i_0 * CE152.amplifier_gain_a_v / rig.amplifier_gain_a_v
    return Controller(
        kind="lqi",
        gains=(0.49, 1700.0 / gain, 17.7 / gain, -17600.0 / gain),
        operating_point=OperatingPoint(i_c_a=i_0, x_m=MIDDLE_M, u_c_v=u_0),
    )


@pytest.mark.slow
def test_the_proposed_experiment_splits_on_the_emulated_board_what_narrow_steps_cannot() -> None:
    bench = Bench(gap_m=2.5e-4, seed=4)
    rig = bench.rig
    believed = replace(
        THETA, K_A=rig.amplifier_gain_a_v, T_A=rig.amplifier_time_constant_s, K_c=rig.force_constant_n_m2_a2,
        b=rig.drag_n_s_m,
    )  # fmt: skip
    before = bench.narrow()
    criterion = criterion_of(before, bench.plant)
    correct = fitted(criterion, strong(GAP, 1e-4, believed), GAP)
    confounder = fitted(criterion, strong(EXPONENT, 1.95, believed), EXPONENT)
    assert abs(z_of(correct, confounder)) < ENOUGH_Z

    proposals = propose(criterion, correct, GAP, [as_trial(EXPONENT, confounder, correct)], bench.controller)
    best = next(proposal for proposal in proposals if ITEMS[proposal.name].closed_loop)
    criterion = criterion_of([*before, bench.perform(ITEMS[best.name])], bench.plant)
    correct, confounder = fitted(criterion, correct.theta, GAP), fitted(criterion, confounder.theta, EXPONENT)

    assert best.separable
    assert z_of(correct, confounder) > ENOUGH_Z
    d_m = correct.theta.value(f"{GAP}.d_m")
    assert abs(d_m - 2.5e-4) < 4.0 * correct.std(f"{GAP}.d_m", bench.plant)
