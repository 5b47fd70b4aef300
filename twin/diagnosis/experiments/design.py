"""Experiment design: which experiment distinguishes two causes of an equivalence class.

Each experiment of the menu is simulated with the model of the named cause.  Delta is the difference of the whitened
innovations between this model and the fitted confounder.  A change xi of the confounder's parameters could compensate
part of it, within the limits that the campaign and the experiment set:

    z^2 = min over xi of |Delta_campaign + J_campaign xi|^2 + |Delta_experiment + J_experiment xi|^2

(S 11) of docs/theory/statistics.md (A. C. Atkinson, V. V. Fedorov, 1975), with J the whitened derivatives by the
paper's parameters, the stops and the confounder's own.  The confounder was fitted to the campaign, so
|Delta_campaign|^2 is twice the difference of log-likelihood there, and J_campaign' Delta_campaign is 0.

Rule 1: both models have the noise levels of the named cause, so only the predictions differ.
Rule 2: an experiment in which the ball would not stay in flight is not proposed.
Rule 3: up to z = 10, a refit with the experiment gives that z within its error of 1.  Beyond 20 it gives a quarter to
        two thirds of it, because the confounder's fit attributes part of a clear misfit to process noise; experiments
        with similar z may then change places (tests/twin/diagnosis/experiments/test_design.py).
Rule 4: for a pair that no experiment of the menu separates, the result gives a measurement with other instruments.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from protocol.campaign import Controller
from protocol.experiments import Experiment
from twin.diagnosis.experiments.closed_loop import Rig, converters_of
from twin.diagnosis.experiments.designed_law import lift_off_input
from twin.diagnosis.experiments.schedules import MENU, schedule_of, sentence
from twin.diagnosis.experiments.virtual_recordings import input_limit, simulate
from twin.diagnosis.search.candidate_fits import Trial
from twin.estimation.innovations import RESTS_HIGH, RESTS_LOW, information
from twin.estimation.record import FloatArray, Record
from twin.evidence.gather import Evidence, gather
from twin.inference.budget import Budget
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.optimiser import inverse
from twin.inference.theta import COLOURS, NOISES, PARAMETERS, STOPS, derivative_step, moved
from twin.model.causes.catalogue import measurement_for, with_trait
from twin.settings import diagnosis as settings

ENOUGH_Z = math.sqrt(2.0 * settings.EQUIVALENT_GAIN)  # two causes with a larger z are not in one equivalence class
_STOP_SHARE = 0.02  # of the travel
_SEED = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two causes, and their separation by one experiment."""

    cause: str
    confounder: str
    now_z: float  # separation by the campaign so far, standard errors
    separation_z: float  # separation with the experiment added
    separable: bool  # whether any experiment of the menu separates them
    measurement: str  # with other instruments, for a pair that is not separable


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """An experiment, and the pairs of causes that it separates."""

    name: str
    what: str  # instruction for the user
    command: str
    separation_z: float  # smallest over the separable pairs, or over all pairs if there are none
    separable: bool  # whether the experiment separates these pairs
    pairs: tuple[Pair, ...]


def propose(
    criterion: Criterion,
    fit: Fit,
    cause: str,
    confounders: Sequence[Trial],
    controller: Controller | None,
    budget: Budget | None = None,
) -> list[Proposal]:
    """The menu's experiments, best first; empty without a confounder.

    Args:
        criterion: of the recordings so far.
        fit: of the model with the named cause.
        cause: name of that cause.
        confounders: fits of the causes that the recordings cannot distinguish from it.
        controller: of the board; None: LQI designed for the rig.
        budget: for the runs along the experiments; None: no limit.

    Raises:
        Spent: the runs exceed the budget.
    """
    if not confounders:
        return []
    ranked = rank(criterion, fit, controller, [trial.fit for trial in confounders], budget)
    now = [math.sqrt(2.0 * max(fit.loglik - trial.fit.loglik, 0.0)) for trial in confounders]
    best = [max((zs[k] for _, zs in ranked), default=0.0) for k in range(len(confounders))]
    can = [z >= ENOUGH_Z for z in best]
    proposals = []
    lift_off_v = lift_off_input(fit.theta, criterion.plant)
    for experiment, zs in ranked:
        pairs = tuple(
            Pair(
                cause=cause,
                confounder=trial.cause,
                now_z=now[k],
                separation_z=zs[k],
                separable=can[k],
                measurement="" if can[k] else measurement_for(cause, trial.cause),
            )
            for k, trial in enumerate(confounders)
        )
        # By the worst pair that can be separated at all: a mean would hide the pair that stays.
        counts = [pair.separation_z for pair in pairs if pair.separable] or [pair.separation_z for pair in pairs]
        smallest = min(counts)
        proposals.append(
            Proposal(
                name=experiment.name,
                what=sentence(experiment, lift_off_v=lift_off_v, travel_m=criterion.plant.travel_m),
                command=f"board51 campaign run FOLDER --experiment {experiment.name}",
                separation_z=smallest,
                separable=smallest >= ENOUGH_Z,
                pairs=pairs,
            )
        )
    return sorted(proposals, key=lambda proposal: -proposal.separation_z)


def rank(
    criterion: Criterion,
    fit: Fit,
    controller: Controller | None,
    members: Sequence[Fit],
    budget: Budget | None = None,
) -> list[tuple[Experiment, tuple[float, ...]]]:
    """Return each possible experiment with the separation z from every member after adding it.

    Args:
        criterion: of the recordings so far.
        fit: of the model that is simulated.
        controller: of the board; None: LQI designed for the rig.
        members: the confounders, fitted to the same recordings.
        budget: as in `propose`.
    """
    plant = criterion.plant
    lift_off_v = lift_off_input(fit.theta, plant)
    u_max_v = min(
        (input_limit(record) for record in criterion.evidence.records if record.kind == "closed-loop"), default=math.inf
    )
    rig = Rig(
        theta=fit.theta,
        plant=plant,
        controller=controller,
        tick_s=criterion.tick_s,
        u_max_v=u_max_v,
        converters=converters_of(criterion.evidence.records),
    )
    causes = {name.partition(".")[0] for fitted in (fit, *members) for name, _ in fitted.theta.causes}
    held = [_information_on(fit, member) for member in members]
    ranked = []
    for experiment in MENU:
        # Minutes of warming separate nothing where no cause warms.
        if experiment.warms and not causes & with_trait("warms"):
            continue
        schedule, times = schedule_of(
            experiment, lift_off_v=lift_off_v, travel_m=plant.travel_m, tick_s=criterion.tick_s
        )
        if not np.isfinite(schedule.command).all() or not np.isfinite(schedule.bursts).all():
            continue
        records = simulate(rig, schedule, seed=_SEED)
        if experiment.closed_loop and not _floats(records[0], criterion):
            continue
        evidence = _gathered(records, criterion, experiment)
        trial = Criterion(evidence, plant, criterion.tick_s, budget=budget)
        try:
            zs = _separations(trial, fit, members, held, times)
        finally:
            trial.close()
        ranked.append((experiment, zs))
    return ranked


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tied:
    """Information of the campaign so far on a confounder's parameters."""

    names: tuple[str, ...]
    gram: FloatArray  # Fisher information on these parameters, with free noise levels
    lead: float  # |Delta_campaign|^2


def _information_on(named_fit: Fit, member: Fit) -> _Tied:
    indices = [
        index
        for index, name in enumerate(member.free)
        if name not in NOISES + COLOURS and member.covariance[index, index] > 0.0
    ]
    # The inverse of a block of the covariance has the noise levels free.  A block of the information would hold them.
    gram = inverse(member.covariance[np.ix_(indices, indices)]) if indices else np.zeros((0, 0))
    lead = 2.0 * max(named_fit.loglik - member.loglik, 0.0)
    return _Tied(names=tuple(member.free[index] for index in indices), gram=gram, lead=lead)


def _floats(record: Record, criterion: Criterion) -> bool:
    travel = criterion.plant.travel_m
    at_stop = (record.x < _STOP_SHARE * travel) | (record.x > (1.0 - _STOP_SHARE) * travel) | ~np.isfinite(record.x)
    return float(np.mean(at_stop)) <= settings.CONTACT_SHARE


def _gathered(records: Sequence[Record], criterion: Criterion, experiment: Experiment) -> Evidence:
    known = (criterion.evidence.low_m, criterion.evidence.high_m)
    # If the campaign does not show the stops, they are taken from an experiment that touches them.
    return gather(records, criterion.plant, known if experiment.closed_loop or None not in known else None)


def _separations(
    trial: Criterion, named_fit: Fit, members: Sequence[Fit], held: Sequence[_Tied], times: float
) -> tuple[float, ...]:
    """Return the separation z of each member with this experiment added; `times`: weight of its information."""
    plant, series = trial.plant, trial.evidence.series
    if not len(series):
        return tuple(math.sqrt(tied.lead) for tied in held)
    rests = bool((series.flags & (RESTS_LOW | RESTS_HIGH)).any())
    common = [*PARAMETERS, *(STOPS if rests else ())]
    steps = [derivative_step(named_fit.theta, name, plant) for name in common]
    thetas = [
        named_fit.theta,
        *(moved(named_fit.theta, name, step, plant) for name, step in zip(common, steps, strict=True)),
    ]
    spans = []
    for member, tied in zip(members, held, strict=True):
        confounder = member.theta
        for name in NOISES + COLOURS:
            confounder = confounder.having(name, named_fit.theta.value(name))
        names = [name for name in tied.names if "." in name]
        changes = [derivative_step(confounder, name, plant) for name in names]
        spans.append((len(thetas), names, changes))
        thetas += [
            confounder,
            *(moved(confounder, name, step, plant) for name, step in zip(names, changes, strict=True)),
        ]
    # The phases of the campaign are not those of an experiment.
    outs = trial.several([replace(theta, phases_s=()) for theta in thetas])
    base = outs[0]
    shared = {name: (outs[1 + k] - base) / steps[k] for k, name in enumerate(common)}
    separations = []
    for (first, names, changes), tied in zip(spans, held, strict=True):
        cause_moves = {name: (outs[first + 1 + k] - outs[first]) / changes[k] for k, name in enumerate(names)}
        moves = shared | cause_moves
        rows = [outs[first] - base, *(moves.get(name, np.zeros_like(base)) for name in tied.names)]
        separations.append(_separation(base, np.array(rows), tied, times))
    return tuple(separations)


def _separation(base: FloatArray, rows: FloatArray, tied: _Tied, times: float) -> float:
    rows[:, :, 2:] = 0.0  # only the predictions differ, not their covariances
    count = len(rows)
    gram = np.zeros((count, count))
    information(base, rows, np.empty((len(base), count)), gram)
    if not np.isfinite(gram).all():
        return math.sqrt(tied.lead)  # the confounder's filter diverges: no gain is assumed
    gram *= times
    cross = gram[1:, 0]
    # (S 11) in closed form: both squares are quadratic in xi, and J_campaign' Delta_campaign is 0.
    left = gram[0, 0] - float(cross @ inverse(tied.gram + gram[1:, 1:]) @ cross)
    return math.sqrt(tied.lead + max(left, 0.0))
