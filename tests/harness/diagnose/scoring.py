"""The judgement of a diagnosis against the hidden truth.  Pure: truth and diagnosis.json in, judgement out.

Rule 1: a single cause is right if it is named first, or is in the class (name and `indistinguishable_from`) of the
        first, and that class has at most 3 members.
Rule 2: a composite is scored by the share of its truths that any named cause or its class (at most 3) contains.
Rule 3: a null is right if the verdict is `model-adequate`; an effect outside the catalogue if it is `unknown-cause`,
        whatever was named besides (it may explain a part); named without that reserve it is a false name.  One that
        the catalogue has learnt is right by rule 1.
Rule 4: where the catalogue lacks the hidden effect, every name that holds is false.  The curve, or the first candidate,
        is at the right place if it is of the effect's family.
Rule 5: a cause that the diagnosis lists as not testable is neither right nor wrong: it is counted by itself.  So is a
        limit that no recording reached, where the answer is `model-adequate`: it is in the rig and not in the data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from twin.model.causes.catalogue import CATALOGUE
from twin.model.causes.curve import CURVES

MAX_CLASS = 3
FAMILIES = {cause.name: cause.family for cause in (*CATALOGUE, *CURVES)}
ADEQUATE, UNKNOWN, CAUSES_FOUND = "model-adequate", "unknown-cause", "causes-found"
NOT_IN_THE_DATA = "not-in-the-data"


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """An entry of `causes`."""

    name: str
    members: tuple[str, ...]  # of its class, itself first
    confidence: float  # NaN if not given


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The parts of a diagnosis that are judged."""

    verdict: str
    causes: tuple[Named, ...] = ()
    not_testable: tuple[str, ...] = ()
    minor_effects: tuple[tuple[str, float], ...] = ()  # name and gain of log-likelihood
    baseline_rmse_m: float = math.nan
    extended_rmse_m: float = math.nan
    noise_floor_m: float = math.nan
    family: str = ""  # of the curve for what is left, else of the first candidate; "": neither
    remainder_rmse_m: float = math.nan  # of the model with that curve


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A judged campaign; a field that does not apply is None."""

    right: bool | None  # the campaign's own question answered; None: said to be not testable, or not in the data
    first: bool  # singles: the truth is the first name itself
    column: str  # column of the confusion matrix
    hits: int = 0  # truths in any class
    truths: int = 0
    false_names: int = 0  # named causes whose class holds no truth
    confidence: float | None = None  # of the first cause
    removed: float | None = None  # share of the error above the noise floor that the extension removes on judge data
    in_family: bool | None = None  # of `knock-out`: what is left is sought in the right part of the loop


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A line of the results: what was hidden, what was answered, what that is worth."""

    part: str
    seed: int
    program: str  # digest of the code that answered
    quick: bool
    plant: str
    grade: str
    truths: tuple[str, ...]
    strengths: tuple[float, ...]
    status: str  # answered | grounded | failed
    verdict: str = ""
    named: tuple[str, ...] = ()
    not_testable: tuple[str, ...] = ()
    minor_effects: tuple[tuple[str, float], ...] = ()  # seen, too small to be named: name and gain of log-likelihood
    record_s: float = 0.0
    diagnose_s: float = 0.0
    message: str = ""
    judgement: Judgement | None = field(default=None)

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as one line of a file has it."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Outcome:
        """Back from `to_json`."""
        fields = dict(values)
        for key in ("truths", "strengths", "named", "not_testable"):
            fields[key] = tuple(fields[key])
        fields["minor_effects"] = tuple((str(name), float(gain)) for name, gain in fields.get("minor_effects", ()))
        if fields["judgement"] is not None:
            fields["judgement"] = Judgement(**fields["judgement"])
        return cls(**fields)


def read_answer(diagnosis: Mapping[str, Any]) -> Answer:
    """The parts of diagnosis.json (design.md) that count."""
    gain = diagnosis.get("gain") or {}
    judge = gain.get("judge") or {}

    def number(key: str) -> float:
        value = judge.get(key)
        return float(value) if isinstance(value, int | float) else math.nan

    remainder = diagnosis.get("remainder") or {}
    curves = [curve["name"] for curve in remainder.get("curves", ()) if curve["in_model"]]
    candidates = [cause["name"] for cause in (*remainder.get("proposed", ()), *diagnosis.get("candidates", ()))]
    left = (remainder.get("judge") or {}).get("extended_rmse_m")
    return Answer(
        family=next((FAMILIES[name] for name in (*curves, *candidates)), ""),
        remainder_rmse_m=math.nan if left is None else float(left),
        verdict=str(diagnosis["verdict"]),
        causes=tuple(
            Named(
                name=cause["name"],
                members=tuple(dict.fromkeys((cause["name"], *cause.get("indistinguishable_from", ())))),
                confidence=float(cause["confidence"]) if cause.get("confidence") is not None else math.nan,
            )
            for cause in diagnosis.get("causes", ())
        ),
        not_testable=tuple(entry["name"] for entry in diagnosis.get("not_testable", ())),
        minor_effects=tuple(
            (effect["name"], float(effect["log_likelihood_gain"])) for effect in diagnosis.get("minor_effects", ())
        ),
        baseline_rmse_m=number("baseline_rmse_m"),
        extended_rmse_m=number("extended_rmse_m"),
        noise_floor_m=number("noise_floor_m"),
    )


def judge(
    part: str, truths: Sequence[str], answer: Answer, *, may_be_adequate: bool = False, in_the_data: bool = True
) -> Judgement:
    """Judge one answer.

    Args:
        part: causes | nulls | composites | outside | gateway | forms | knock-out.
        truths: Names of the hidden effects.
        answer: What the diagnosis said.
        may_be_adequate: Of an effect outside: leaving the damaged samples out is an honest answer, too.
        in_the_data: Of a single cause: whether the recordings would be others without it.
    """
    learnt = part == "outside" and set(truths) <= FAMILIES.keys()
    known = set(truths) if part in ("causes", "composites", "gateway", "forms") or learnt else set()
    hits = {truth for truth in known if any(truth in _class(cause) for cause in answer.causes)}
    false_names = sum(not (known & set(_class(cause))) for cause in answer.causes)
    confidence = answer.causes[0].confidence if answer.causes else math.nan
    first = bool(answer.causes) and answer.causes[0].name in known
    right: bool | None
    if part == "nulls":
        right = answer.verdict == ADEQUATE and not answer.causes
    elif part == "outside" and not learnt:
        right = answer.verdict == UNKNOWN or (may_be_adequate and answer.verdict == ADEQUATE and not answer.causes)
    elif part == "knock-out":
        right = not answer.causes
    elif part == "composites":
        right = hits == known
    else:
        right = bool(answer.causes) and bool(known & set(_class(answer.causes[0])))
        adequate = answer.verdict == ADEQUATE and not answer.causes
        if not right and (known <= set(answer.not_testable) or (adequate and not in_the_data)):
            right = None
    return Judgement(
        right=right,
        first=first,
        column=_column(known, answer) if in_the_data or right is not None else NOT_IN_THE_DATA,
        hits=len(hits),
        truths=len(known),
        false_names=false_names,
        confidence=None if math.isnan(confidence) else confidence,
        removed=removed_share(answer),
        in_family=answer.family == FAMILIES[truths[0]] if part == "knock-out" and answer.family else None,
    )


def removed_share(answer: Answer) -> float | None:
    """(baseline - extended) / (baseline - floor) of the rms errors on judge data, at most 1.

    None where the baseline is within 5 % of the floor: there is no excess to remove, only its statistical error.
    """
    base, extended, floor = answer.baseline_rmse_m, answer.extended_rmse_m, answer.noise_floor_m
    if math.isfinite(answer.remainder_rmse_m):
        extended = answer.remainder_rmse_m
    if not (math.isfinite(base) and math.isfinite(extended) and math.isfinite(floor)) or base < 1.05 * floor:
        return None
    return min((base - extended) / (base - floor), 1.0)


def _class(cause: Named) -> tuple[str, ...]:
    """Return the causes that a named cause stands for; a class of more than 3 stands for its name alone."""
    return cause.members if len(cause.members) <= MAX_CLASS else (cause.name,)


def _column(known: set[str], answer: Answer) -> str:
    """Column of the confusion matrix: the truth where the first class has it, else the first name, else the verdict."""
    if not known and answer.verdict == UNKNOWN:
        return UNKNOWN
    if not answer.causes:
        return "not-testable" if known and known <= set(answer.not_testable) else answer.verdict
    named = known & set(_class(answer.causes[0]))
    return min(named) if named else answer.causes[0].name
