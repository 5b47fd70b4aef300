"""Checks that the numbers of one diagnosis.json agree.  Pure: the file's content in, contradictions out.

Rule 1: shares are parts of one whole, and with what is left they make it up.
Rule 2: a verdict says what the numbers say, and no name is surer than the verdict allows.
Rule 3: the sentence has the numbers of the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from twin.diagnosis.report.quantities import micrometres, percent
from twin.estimation.prediction_floor import TOLERANCE
from twin.settings import diagnosis as settings

COUNTED = "lost-samples"  # its gaps are counted: no likelihood, no share
_ROUNDING = 1e-6


def disagreements(data: Mapping[str, Any]) -> list[str]:
    """Return the contradictions; empty where all agrees."""
    return [*_shares(data), *_verdict(data), *_confidence(data), *_gains(data), *_judge_errors(data), *_sentence(data)]


def _shares(data: Mapping[str, Any]) -> Iterator[str]:
    named = [cause["share_of_excess_explained"] for cause in _listed(data)]
    jointly, left = data["jointly_explained"]["share_of_excess"], data["unexplained"]["share_of_excess"]
    parts = [*named, jointly, left]
    if not all(0.0 <= share <= 1.0 for share in parts):
        yield f"shares are no parts of one whole: {parts}"
    inferred = any(cause["name"] != COUNTED for cause in _listed(data))
    whole = 1.0 if inferred or left > 0.0 else 0.0
    if abs(sum(parts) - whole) > _ROUNDING:
        yield f"shares {named}, jointly {jointly} and unexplained {left} sum to {sum(parts):.4f}"
    if "excess" in data:
        explained, missing = data["excess"]["explained"], data["excess"]["left"]
        if explained + missing > 0.0 and abs(missing / (explained + missing) - left) > _ROUNDING:
            yield f"unexplained {left} is not {missing} of {explained + missing}"


def _verdict(data: Mapping[str, Any]) -> Iterator[str]:
    verdict, left = data["verdict"], data["unexplained"]["share_of_excess"]
    if (verdict in ("causes-found", "partly-explained")) and not data["causes"]:
        yield f"{verdict} without a cause"
    if verdict == "model-adequate" and _listed(data):
        yield "model-adequate with causes"
    if verdict in ("unknown-cause", "unfinished") and any(cause["name"] != COUNTED for cause in data["causes"]):
        yield f"{verdict}, and candidates are listed as causes"
    low = (_judge(data).get("ci95_over_floor") or [None])[0]
    exceeds = low is not None and low > TOLERANCE
    static = "static" in data  # points of rest have an unknown noise: an F test decides
    if verdict in ("causes-found", "model-adequate") and not static:
        if left > 0.0:
            yield f"{verdict}, and {left} of the excess is unexplained"
        if data["jointly_explained"]["share_of_excess"] > 0.5:
            yield f"{verdict}, and the names explain more jointly than apart"
        if exceeds:
            yield f"{verdict}, and the judge recordings lie surely above the noise floor: {low:.3f} times at least"
    if verdict in ("partly-explained", "unknown-cause"):
        rivalled = any(cause.get("rival") for cause in _listed(data))  # what is not known is then where it belongs
        jointly = data["jointly_explained"]["share_of_excess"]
        overlap = jointly > sum(cause["share_of_excess_explained"] for cause in _listed(data))
        if left == 0.0 and not exceeds and not data["unexplained"]["where"] and not (rivalled or overlap):
            yield f"{verdict}, and nothing is said to be left"
        if not data["unexplained"]["where"] and not data["warnings"]:
            yield f"{verdict} without a word on what is left"


def _confidence(data: Mapping[str, Any]) -> Iterator[str]:
    for cause in _listed(data):
        limit = 1.0 if cause["name"] == COUNTED else settings.MAX_CONFIDENCE.get(data["verdict"], 0.0)
        if not 0.0 <= cause["confidence"] <= limit + _ROUNDING:
            yield f"{cause['name']} is sure to {cause['confidence']} beside {data['verdict']}"


def _gains(data: Mapping[str, Any]) -> Iterator[str]:
    for cause in _listed(data) if "excess" in data else ():
        if cause["log_likelihood_gain"] > data["excess"]["explained"] * (1.0 + _ROUNDING):
            yield f"{cause['name']} gains {cause['log_likelihood_gain']}, all together {data['excess']['explained']}"


def _judge_errors(data: Mapping[str, Any]) -> Iterator[str]:
    for gain in data.get("gains", ()):
        judge = gain["judge"]
        base, after, floor = (judge[key] for key in ("baseline_rmse_m", "extended_rmse_m", "noise_floor_m"))
        ratio, (low, high) = after / base, judge["ci95_ratio"]
        if not low - _ROUNDING <= ratio <= high + _ROUNDING:
            yield f"ratio {ratio:.4f} is outside its interval {low:.4f} to {high:.4f}"
        removed = judge["excess_removed"]
        if removed is not None and floor is not None:
            expected = min((base**2 - after**2) / (base**2 - floor**2), 1.0)
            if not math.isclose(removed, expected, rel_tol=1e-6, abs_tol=1e-9):
                yield f"excess_removed {removed} is not that of the errors beside it, {expected}"
    at = data.get("gain") or {}
    if "horizon_s" in at and at not in data["gains"]:
        yield "the gain at 20 ms is none of the gains"


def _sentence(data: Mapping[str, Any]) -> Iterator[str]:
    text, named = data["sentence"], [entry for entry in _listed(data) if entry["share_of_excess_explained"] > 0.0]
    if "static" in data:
        return
    if (data.get("remainder") or {}).get("beside") == "paper":  # a curve that needs none of them
        missing = [entry["name"] for entry in named if entry["name"] not in text]
        if missing:
            yield f"the sentence lacks {', '.join(missing)}: {text}"
        named = []
    for cause in named:
        if cause["sentence"][1:] not in text or percent(cause["share_of_excess_explained"]) not in text:
            yield f"the sentence lacks {cause['name']} with its {percent(cause['share_of_excess_explained'])}: {text}"
    judge = _judge(data)
    if named and judge and "extending the model" in text:
        for key in ("baseline_rmse_m", "extended_rmse_m", "noise_floor_m"):
            if judge[key] is not None and micrometres(judge[key]) not in text:
                yield f"the sentence lacks {key} = {micrometres(judge[key])}: {text}"
    reservations = ("imitate an unknown", "not everything is explained", "none of the known causes")
    reserved = any(words in text for words in reservations)
    if reserved != (data["verdict"] in ("partly-explained", "unknown-cause")):
        yield f"{data['verdict']} is not what the sentence says: {text}"


def _listed(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [*data["causes"], *data.get("candidates", ())]


def _judge(data: Mapping[str, Any]) -> Mapping[str, Any]:
    return (data.get("gain") or {}).get("judge") or {}
