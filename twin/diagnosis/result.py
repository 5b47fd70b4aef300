"""The result of a diagnosis, and its JSON form (`diagnosis.json`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from twin.diagnosis.judge.account import Account, Verdict
from twin.diagnosis.judge.choice import Choice
from twin.diagnosis.judge.prediction_gain import Gain
from twin.diagnosis.remainder.remainder import Remainder
from twin.diagnosis.remainder.rivals import Rival
from twin.diagnosis.search.state import Selection
from twin.distributions import Z_95
from twin.evidence.gather import Evidence
from twin.evidence.noise_levels import colours_json
from twin.evidence.noise_levels import to_json as noise_json
from twin.inference.budget import Budget
from twin.inference.fisher_scoring import Fit
from twin.inference.noise_floor import Floor
from twin.inference.theta import Theta
from twin.inference.trade_offs import TradeOff
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model, Parameter
from twin.page.plain import plain
from twin.settings import diagnosis as settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A cause that explains the same as the one that is named."""

    name: str
    parameters: Mapping[str, Parameter]
    sentence: str = ""  # with its size
    lead: float = 0.0  # log-likelihood by which it explains more than the cause that is named

    @property
    def stated(self) -> bool:
        """Return whether it is an error of a value that the campaign states."""
        return BY_NAME[self.name].detector == "stated"


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """An experiment that would tell the members of a class apart, or why none can."""

    what: str
    separation_z: float
    command: str = ""
    outside: tuple[str, ...] = ()  # pairs that no experiment separates, with the measurement that would
    next_best: tuple[tuple[str, float], ...] = ()  # next best experiments and their z
    now_z: Mapping[str, float] = field(default_factory=dict)  # by confounder: separation by the recordings so far
    experiments: tuple[
        tuple[str, Mapping[str, float]], ...
    ] = ()  # all of them: by confounder, separation with it added


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A named cause with its parameters, its gain and the causes that fit as well."""

    name: str
    sentence: str
    parameters: Mapping[str, Parameter]
    confidence: float
    indistinguishable_from: tuple[Member, ...]
    share_of_excess_explained: float
    loglik_gain: float
    next_experiment: Proposal | None = None
    begins_in: str = ""  # the recording with which it begins, where it is not there from the first
    ends_after: str = ""  # the last recording that has it
    form: str = ""  # of the literature that is nearest to its shape; "": the usual one
    rival: Rival | None = None  # a curve of unknown origin that explains more in its place


@dataclass(frozen=True, slots=True, kw_only=True)
class SpectralLine:
    """A line in a spectrum."""

    channel: str  # x or i_c: an error of its sensor, or unexplained; force; u_c: the loop's answer to one of these
    cause: str  # that explains it; "": none does
    frequency_hz: Parameter
    amplitude: Parameter
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Excluded:
    """A cause that these data cannot show, or that was tried and did not earn its place."""

    name: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MinorEffect:
    """A cause that gains more than chance does, and too little beside what was named to be named itself."""

    name: str
    parameters: Mapping[str, Parameter]
    loglik_gain: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """Everything that was found; what `twin/diagnosis/report/page.py` shows."""

    verdict: Verdict
    headline: str  # the answer in at most two short sentences
    sentence: str  # the answer with its numbers
    causes: tuple[Finding, ...]
    not_testable: tuple[Excluded, ...]
    minor_effects: tuple[MinorEffect, ...]
    ruled_out: tuple[Excluded, ...]
    account: Account  # of what the paper's model lacks
    unexplained_where: str
    gains: tuple[Gain, ...]  # of `after` over `before` on judge recordings, one per horizon
    gain: Gain | None  # at 20 ms
    baseline: Model
    extended: Model
    warnings: tuple[str, ...]
    quick: bool
    stages_s: Mapping[str, float]  # time that each stage took
    selection: Selection
    floor: Floor
    fit_evidence: Evidence
    judge_evidence: Evidence | None
    before: Theta  # of `baseline`
    after: Theta  # of `extended`, without a curve of what is left
    tick_s: float
    remainder: Remainder | None = None  # what is left, modelled; `extended` has it
    budget: Budget = field(default_factory=Budget)
    choice: Choice | None = None  # how `extended` was chosen
    lines: tuple[SpectralLine, ...] = ()  # in the spectra of the recordings for fitting
    trade_offs: tuple[TradeOff, ...] = ()  # of the parameters with the named causes

    @property
    def offered(self) -> bool:
        """Return whether a twin gains by `extended`: the judge recordings compared it, and it is not the reference."""
        chosen = self.choice
        return chosen is not None and chosen.compared and (bool(self.extended.causes) or chosen.kind == "paper")

    def holds(self, cause: Finding) -> bool:
        """Return whether a finding is a cause and not a candidate; with an unknown rest, only a counted one is."""
        if cause.rival is not None:
            return False
        if self.verdict == "partly-explained" and self.account.leads(cause.name):
            return True
        return self.verdict == "causes-found" or cause.confidence > settings.MAX_CONFIDENCE[self.verdict]


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The contract of diagnosis.json; a number that is not finite is null."""
    content = {
        "verdict": diagnosis.verdict,
        "headline": diagnosis.headline,
        "sentence": diagnosis.sentence,
        "calibrated": not diagnosis.quick,
        "causes": [_finding(cause) for cause in diagnosis.causes if diagnosis.holds(cause)],
        "candidates": [_finding(cause) for cause in diagnosis.causes if not diagnosis.holds(cause)],
        "not_testable": [asdict(entry) for entry in diagnosis.not_testable],
        "minor_effects": [_minor_effect(effect) for effect in diagnosis.minor_effects],
        "ruled_out": [asdict(entry) for entry in diagnosis.ruled_out],
        "jointly_explained": {"share_of_excess": diagnosis.account.jointly},
        "unexplained": {
            "share_of_excess": diagnosis.account.unexplained,
            "where": diagnosis.unexplained_where,
        },
        "excess": {
            "quantity": "log-likelihood of the recordings for fitting, against sensor noise alone",
            "explained": diagnosis.account.explained,
            "left": diagnosis.account.left,
        },
        "noise": noise_json(diagnosis.fit_evidence.noise, (diagnosis.floor.sigma_i_c_a, diagnosis.floor.sigma_x_m)),
        **({"noise_colour": colours} if (colours := colours_json(diagnosis.fit_evidence.noise)) else {}),
        "lines": [_line(line) for line in diagnosis.lines],
        "trade_offs": [_trade_off(pair) for pair in diagnosis.trade_offs],
        "remainder": None if diagnosis.remainder is None else _remainder(diagnosis.remainder, diagnosis.extended),
        "extended_model": _extended_model(diagnosis),
        "plant_assumed": diagnosis.extended.plant.assumed,
        "gain": _gain(diagnosis.gain),
        "gains": [_gain(gain) for gain in diagnosis.gains],
        "warnings": list(diagnosis.warnings),
        "budget": {
            "filter_steps": diagnosis.budget.limit,
            "spent": diagnosis.budget.spent,
            "unanswered": list(diagnosis.budget.unanswered),
        },
        "stages_s": {name: round(seconds, 2) for name, seconds in diagnosis.stages_s.items()},
    }
    return plain(content)


def _minor_effect(effect: MinorEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "parameters": parameters_json(effect.parameters),
        "log_likelihood_gain": effect.loglik_gain,
    }


def _line(line: SpectralLine) -> dict[str, Any]:
    return {
        "channel": line.channel,
        "cause": line.cause or None,
        **parameters_json({"frequency_hz": line.frequency_hz, "amplitude": line.amplitude}),
        "sentence": line.sentence,
    }


def _trade_off(pair: TradeOff) -> dict[str, Any]:
    return {
        "parameters": list(pair.names),
        "correlation": pair.correlation,
        "std": list(pair.stds),
        "determined": None if pair.weights is None else list(pair.weights),
        "log_likelihood_drops": list(pair.drops),
    }


def _finding(cause: Finding) -> dict[str, Any]:
    proposal = cause.next_experiment
    return {
        "name": cause.name,
        "sentence": cause.sentence,
        "parameters": parameters_json(cause.parameters),
        "form": cause.form or None,
        "confidence": round(cause.confidence, 3),
        "indistinguishable_from": [member.name for member in cause.indistinguishable_from],
        "alternatives": [
            {
                "name": member.name,
                "sentence": member.sentence,
                "stated": member.stated,
                "log_likelihood_lead": member.lead,
                "parameters": parameters_json(member.parameters),
                "confirm": BY_NAME[member.name].confirm,
            }
            for member in cause.indistinguishable_from
        ],
        "share_of_excess_explained": cause.share_of_excess_explained,
        "log_likelihood_gain": cause.loglik_gain,
        "at_the_rig": {"confirm": BY_NAME[cause.name].confirm, "cure": BY_NAME[cause.name].cure},
        "rival": None
        if cause.rival is None
        else {"name": cause.rival.curve.name, "log_likelihood_lead": cause.rival.lead},
        "begins_in": cause.begins_in or None,
        "ends_after": cause.ends_after or None,
        "next_experiment": None
        if proposal is None
        else {
            "what": proposal.what,
            "separation_z": proposal.separation_z,
            "command": proposal.command,
            "not_separable_here": list(proposal.outside),
            "others": [{"name": name, "separation_z": z} for name, z in proposal.next_best],
            "separation_z_now": dict(proposal.now_z),
            "experiments": [{"name": name, "separation_z": dict(zs)} for name, zs in proposal.experiments],
        },
    }


def fit_parameters(fit: Fit, cause: str, std: Mapping[str, float]) -> dict[str, Parameter]:
    """The parameters of one cause of a fit, with intervals."""
    parameters = {}
    for parameter in BY_NAME[cause].parameters:
        value = fit.theta.value(f"{cause}.{parameter.name}")
        spread = std.get(f"{cause}.{parameter.name}", math.nan)
        known = math.isfinite(spread) and spread > 0.0
        parameters[parameter.name] = Parameter(
            value=float(value),
            unit=parameter.unit,
            std=float(spread) if known else None,
            ci95=(
                max(float(value - Z_95 * spread), parameter.low),
                min(float(value + Z_95 * spread), parameter.high),
            )
            if known
            else None,
            verdict="identified" if known and Z_95 * spread < 0.25 * max(abs(value), 1e-300) else "weak",
            method="maximum likelihood of the innovations, all recordings together",
            equation=BY_NAME[cause].equation,
        )
    return parameters


def parameters_json(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return the parameters as in diagnosis.json."""
    return {
        name: {"value": p.value, "unit": p.unit, "std": p.std, "ci95": list(p.ci95) if p.ci95 else None}
        for name, p in parameters.items()
    }


def _extended_model(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return which model extended_model.json is, and the models that were refused."""
    choice = diagnosis.choice
    if choice is None:
        return None
    return {
        "is": choice.kind,
        "causes": [cause.name for cause in diagnosis.extended.causes],
        "judged": choice.compared,
        "offered": diagnosis.offered,
        "refused": [
            {
                "causes": list(refusal.causes),
                "why": "worse" if refusal.worse else "not surely better",
                **(_gain(refusal.gain) or {}),
            }
            for refusal in choice.refused
        ],
    }


def _gain(gain: Gain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {
        "horizon_samples": gain.samples,
        "horizon_s": gain.horizon_s,
        "judge": {
            "baseline_rmse_m": gain.baseline_rmse_m,
            "extended_rmse_m": gain.extended_rmse_m,
            "ci95_ratio": gain.ci95_ratio,
            "ci95_over_floor": gain.ci95_floor,
            "noise_floor_m": gain.floor_m,
            "excess_removed": gain.removed,
            "samples": gain.count,
        },
    }


def _remainder(remainder: Remainder, extended: Model) -> dict[str, Any]:
    improvement = remainder.improvement
    return {
        "beside": remainder.extends,
        "curves": [
            {
                "name": shape.curve.name,
                "in_model": in_model,
                "title": shape.curve.title,
                "share": shape.curve.acts_on,
                "at_unit": shape.curve.parameters[0].unit,
                "at": shape.at.tolist(),
                "mean": shape.share.tolist(),
                "ci95": [shape.low.tolist(), shape.high.tolist()],
            }
            for shapes, in_model in ((remainder.shapes, True), (remainder.replaced, False))
            for shape in shapes
        ],
        "proposed": [
            {"name": cause.name, "parameters": parameters_json(cause.parameters)}
            for cause in extended.causes
            if cause.name in remainder.proposed
        ],
        "tried": [
            {
                "name": attempt.name,
                "beside": attempt.extends,
                "log_likelihood_gain": attempt.loglik_gain,
                "rmse_m": attempt.rmse_m,
                "form_absorbed": attempt.absorbed,
            }
            for attempt in remainder.attempts
        ],
        "judge": {
            "horizon_s": improvement.horizon_s,
            "causes_rmse_m": improvement.causes_rmse_m,
            "extended_rmse_m": improvement.extended_rmse_m,
            "ci95_ratio": improvement.ci95_ratio,
            "noise_floor_m": improvement.floor_m,
            "excess_removed": improvement.removed,
            "flexible_rmse_m": improvement.flexible_rmse_m,
            "samples": improvement.count,
        },
    }
