"""A diagnosis whose answer is known, without a search: the rig is `THETA` with one cause, the baseline is `THETA`.

Numbers of the models are those of the rig itself, so every error above the noise floor is the cause's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from protocol.campaign import Campaign
from tests.harness.diagnose.simulated_rig import MIDDLE_M, PLANT, THETA, TICK_S, controller, rig_of, strong
from twin.diagnosis.experiments.virtual_recordings import Schedule, simulate
from twin.diagnosis.judge.account import account_of
from twin.diagnosis.judge.prediction_gain import Yardstick
from twin.diagnosis.report.headline import headline_of
from twin.diagnosis.report.model_file import model_of
from twin.diagnosis.report.sentences import finding_sentence, summary_sentence
from twin.diagnosis.result import Diagnosis, Excluded, Finding, Member, Proposal, fit_parameters
from twin.diagnosis.search.candidate_fits import Trial
from twin.diagnosis.search.forward_step import Round
from twin.diagnosis.search.score_test import Score
from twin.diagnosis.search.state import Selection
from twin.estimation.record import Record
from twin.evidence.gather import gather
from twin.identification.horizon import HORIZONS_S
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.inference.theta import BASE, Theta, coordinates_of

QUIET = replace(THETA, process_a_m_s2=0.02)  # what rounding leaves
LARGE_M_S2 = 1.0  # what a baseline leaves to chance that does not know the cause


def steps(theta: Theta, *, seed: int, use: str = "fit", seconds: float = 12.0, size_m: float = 0.9e-3) -> Record:
    """A flight over reference steps."""
    t = np.arange(round(seconds / TICK_S)) * TICK_S
    command = MIDDLE_M + size_m * np.where(t % 1.2 < 0.6, 1.0, -1.0)
    schedule = Schedule(name=f"steps_{seed}", kind="closed-loop", command=command, closed_loop=True)
    (record,) = simulate(rig_of(theta), schedule, seed=seed)
    return replace(record, use="judge" if use == "judge" else "fit")


def campaign() -> Campaign:
    """Around the records in memory."""
    from pathlib import Path

    return Campaign(
        where="campaign.toml", folder=Path("runs/monday"), plant=PLANT, controller=controller(), recordings=()
    )


def fit_of(theta: Theta, loglik: float) -> Fit:
    free = BASE + tuple(name for name, _ in theta.causes)
    return Fit(theta=theta, loglik=loglik, free=free, covariance=1e-6 * np.eye(len(free)), converged=True)


def diagnosis(
    cause: str,
    value: float,
    *,
    has_judges: bool = True,
    extended: bool = True,
    quick: bool = False,
    seconds: float = 8.0,
) -> Diagnosis:
    """Return the diagnosis of a rig with that cause; `extended`: whether it was found."""
    rig = strong(cause, value, QUIET)
    baseline = replace(QUIET, process_a_m_s2=LARGE_M_S2)
    fit = gather([steps(rig, seed=1, seconds=seconds)], PLANT)
    judge = gather([steps(rig, seed=2, use="judge", seconds=seconds)], PLANT) if has_judges else None
    after = rig if extended else baseline
    criterion = Criterion(fit, PLANT, TICK_S, workers=1)
    logliks = [criterion.value(theta) for theta in (baseline, after)]
    criterion.close()
    before_fit, after_fit = fit_of(baseline, logliks[0]), fit_of(after, logliks[1])
    floor = Floor(
        sigma_i_c_a=QUIET.sigma_i_c_a,
        sigma_x_m=QUIET.sigma_x_m,
        measured=True,
        logliks=(0.0, logliks[1]),
        counts=(len(fit.series), len(fit.series)),
    )
    spread = {name: 0.01 * abs(rig.value(name)) for name in coordinates_of(cause)}
    trial = Trial(cause=cause, fit=after_fit, gain=logliks[1] - logliks[0])
    score = Score(
        cause=cause,
        probe=value,
        gain=trial.gain,
        step=1.0,
        z=9.0,
        detectable=9.0,
        visible=1.0,
        moves=(),
        other_values=(),
    )
    selection = Selection(
        base=before_fit,
        fit=after_fit,
        causes=(cause,) if extended else (),
        gains={cause: trial.gain},
        rounds=(Round(scores=(score,), trials=(trial,), selected=cause if extended else "", best=trial),),
    )
    account = account_of(selection, floor.excess(logliks[1]), extended)
    records = fit.records
    gains = []
    if judge is not None:
        yardstick = Yardstick(judge=judge, floor=floor, plant=PLANT, tick_s=TICK_S, seed=0)
        made = (yardstick.gain(baseline, after, max(round(h / TICK_S), 1)) for h in HORIZONS_S)
        gains = [gain for gain in made if gain is not None]
    result = Diagnosis(
        verdict="causes-found" if extended else "unknown-cause",
        headline="",
        sentence="",
        causes=(_finding(cause, after_fit, spread, account.cause_shares[cause], account.gains[cause]),)
        if extended
        else (),
        not_testable=(Excluded(name="current-sensor-gain", why="absorbed by K_A and K_c"),),
        minor_effects=(),
        ruled_out=(Excluded(name="coulomb-friction", why="F_f is at most 3 µN (95 %)"),),
        account=account,
        unexplained_where="" if extended else "most in x in steps_1",
        gains=tuple(gains),
        gain=next((gain for gain in gains if abs(gain.horizon_s - 0.02) < 1e-3), None),
        baseline=model_of(
            campaign(), before_fit, {}, records, floor.excess(before_fit.loglik), "the paper's model at its best"
        ),
        extended=model_of(campaign(), after_fit, spread, records, floor.excess(after_fit.loglik), "extended"),
        warnings=(),
        quick=quick,
        stages_s={"search": 1.0},
        selection=selection,
        floor=floor,
        fit_evidence=fit,
        judge_evidence=judge,
        before=baseline,
        after=after,
        tick_s=TICK_S,
    )
    return replace(result, headline=headline_of(result, blind=False, off=""), sentence=summary_sentence(result))


def _finding(cause: str, fit: Fit, spread: dict[str, float], share: float, gain: float) -> Finding:
    parameters = fit_parameters(fit, cause, spread)
    confounder = "position-sensor-gain"
    other = fit_parameters(fit_of(strong(confounder, 1.04, QUIET), 0.0), confounder, {f"{confounder}.gain": 0.001})
    return Finding(
        name=cause,
        sentence=finding_sentence(cause, parameters),
        parameters=parameters,
        confidence=0.97,
        indistinguishable_from=(Member(name=confounder, parameters=other),),
        share_of_excess_explained=share,
        loglik_gain=gain,
        next_experiment=Proposal(
            what="raise u_c slowly until the ball leaves its rest",
            separation_z=30.0,
            command="board51 campaign run FOLDER --experiment lift-off",
        ),
    )
