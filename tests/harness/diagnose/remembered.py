"""Diagnoses of one campaign that differ in a decision only: what they compute alike is computed once.

    with remembered():
        ...  # several `diagnose_records` of the same recordings

Rule 1: an answer is kept for its arguments, the recordings, and the settings of `INSIDE`, by which it is computed.
Rule 2: what is taken from here is paid from the budget as if it were computed: the answer does not depend on it.
Rule 3: one thread, `workers=1`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from twin.diagnosis import pipeline
from twin.diagnosis.checks import consistency
from twin.diagnosis.judge.prediction_gain import Yardstick
from twin.diagnosis.search import periodic, prediction_benefit, score_test
from twin.estimation.record import Record
from twin.evidence import dead_time, gather
from twin.inference import fisher_scoring, initial_guess
from twin.inference.fisher_scoring import Fit
from twin.inference.likelihood import Criterion
from twin.inference.noise_floor import Floor
from twin.model.causes.cause import Cause
from twin.settings import diagnosis as settings

# What the functions below compute by; all other settings decide about what they return.
COMPUTE_SETTINGS = (
    "STOP_STD_M",
    "EXACT_SLOPES_SQUARE",
    "BENEFIT_HORIZON_S",
    "BENEFIT_PREDICTIONS",
    "LINE_NEIGHBOURS_HZ",
    "RESTLESS",
    "MIN_NOISE_SHARE",
    "TRIM_SAMPLES",
    "LIFTS_SHARE",
    "STAYS_S",
    "POLE_SHARE",
    "DEAD_TIME_FAST_S",
    "DEAD_TIME_LONGEST_S",
    "SMALL_PROBE",
    "RATE_SPAN_S",
    "PROBE_SAMPLES",
    "FORCE_HIGHEST",
    "WAVE_READINGS",
    "QUICK_FLIGHT_SAMPLES",
    "QUICK_SAMPLES",
    "ROUGH_LEFT",
    "DRIFT_BLOCK_S",
)
_PACKAGES = ("twin.diagnosis", "twin.evidence", "twin.inference")
_FUNCTIONS = (
    (pipeline, "_prepared"),
    (gather, "gather"),
    (initial_guess, "start_theta"),
    (initial_guess, "with_noise_bounds"),
    (dead_time, "dead_time"),
    (fisher_scoring, "climb"),
    (fisher_scoring, "spreads"),
    (score_test, "screen"),
    (periodic, "find_line"),
    (prediction_benefit, "error_reduction"),
    (consistency, "stretches"),
)
_METHODS = (
    (Floor, "under"),
    (Criterion, "value"),
    (Criterion, "values"),
    (Criterion, "white"),
    (Yardstick, "gain"),
)


@contextmanager
def remembered() -> Iterator[None]:
    """Everything that `_FUNCTIONS` and `_METHODS` answer is kept until the end of the block."""
    known: dict[Any, Any] = {}
    before: list[tuple[Any, str, Any]] = []
    for home, name in _FUNCTIONS:
        original = getattr(home, name)
        once = _once(original, known)
        for module in [module for at, module in sys.modules.items() if at.startswith(_PACKAGES)]:
            if getattr(module, name, None) is original:
                before.append((module, name, original))
                setattr(module, name, once)
    for owner, name in _METHODS:
        before.append((owner, name, getattr(owner, name)))
        setattr(owner, name, _once(getattr(owner, name), known))
    try:
        yield
    finally:
        for holder, name, original in before:
            setattr(holder, name, original)
        _DIGESTS.clear()
        _ALIVE.clear()


def _once(work: Callable[..., Any], known: dict[Any, Any]) -> Callable[..., Any]:
    def answer(*args: Any, **named: Any) -> Any:
        criterion = next((item for item in args if isinstance(item, Criterion)), None)
        if criterion is not None and type(criterion) is not Criterion:
            return work(*args, **named)  # it switches causes on and off: the recordings do not tell how
        key = (
            work.__qualname__,
            tuple(getattr(settings, name) for name in COMPUTE_SETTINGS),
            tuple(_key(item) for item in args),
            tuple((name, _key(item)) for name, item in sorted(named.items())),
        )
        if key in known:
            result, steps = known[key]
            if criterion is not None:
                criterion.budget.take(steps)
            return _fresh(result)
        spent = criterion.budget.spent if criterion is not None else 0.0
        result = work(*args, **named)
        known[key] = result, (criterion.budget.spent - spent if criterion is not None else 0.0)
        return _fresh(result)

    return answer


def _fresh(result: Any) -> Any:
    """Lists of its own for each caller, who may append to them."""
    if isinstance(result, list):
        return list(result)
    return tuple(_fresh(item) for item in result) if type(result) is tuple else result


def _key(value: Any) -> Any:
    """A value that is equal where the argument says the same."""
    if isinstance(value, Criterion):
        return "criterion", value.tick_s, _digest(value, value.evidence)
    if isinstance(value, Yardstick):
        return tuple(_key(item) for item in (value.judge, value.floor, value.plant, value.tick_s, value.seed))
    if isinstance(value, Fit):
        return "fit", value.theta, value.free
    if isinstance(value, Cause):
        return value.name
    if isinstance(value, Record):
        _ALIVE[id(value)] = value
        return "recording", id(value)
    if hasattr(value, "series"):
        return "evidence", _digest(value, value)
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return tuple(_key(item) for item in value)
    return value if _hashable(value) else repr(value)


def _hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


_ALIVE: dict[int, Record] = {}  # so that an id is nobody else's
_DIGESTS: dict[int, tuple[Any, str]] = {}


def _digest(owner: Any, evidence: Any) -> str:
    """Return a digest of samples and points of rest; `owner` stays alive with it, so that its id is nobody else's."""
    if id(owner) not in _DIGESTS:
        digest = hashlib.sha256()
        for column in evidence.samples:
            digest.update(column.tobytes())
        digest.update(evidence.series.recording.tobytes() + repr(evidence.statics).encode())
        _DIGESTS[id(owner)] = owner, digest.hexdigest()
    return _DIGESTS[id(owner)][1]
