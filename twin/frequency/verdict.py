"""The answer in words: whether the model explains the loop, at which frequencies, and what the difference looks like.

Rule 1: a false alarm of a right model has at most the probability LEVEL.  Half of it is for the joint tests (one of
        each response and height), half for the single frequencies; Holm's method within each.
Rule 2: the difference is described by the amplifier's response if that is refused, else by the plant's.  Ball and coil
        come after it: i_c is known with noise, and at samples only, so a late u_c looks shorter from i_c to x.
Rule 3: a gain, a delay or a lag "would" explain the difference if the joint test no longer refuses what it leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from twin.distributions import Z_95
from twin.estimation.family import holm
from twin.estimation.record import BoolArray, FloatArray
from twin.frequency.compare import Deviations, chances
from twin.frequency.responses import Name
from twin.frequency.spectra import ComplexArray

LEVEL = 0.05
ORDER: tuple[Name, ...] = ("amplifier", "plant", "ball", "loop")
WORDS: Mapping[Name, str] = {
    "amplifier": "the amplifier (u_c to i_c)",
    "ball": "ball and coil (i_c to x)",
    "plant": "the plant (u_c to x)",
    "loop": "the loop gain",
}
LONGEST_S = 0.02  # of a delay or lag that is tried
Tested = tuple[float, Mapping[Name, Deviations], Mapping[Name, BoolArray]]  # height, m; certain frequencies


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """A simple change of the model's response, fitted to the difference."""

    kind: str  # gain | delay | lag
    value: float  # factor; s
    low: float  # 95 %
    high: float
    p_left: float  # of the joint test of what it leaves

    @property
    def text(self) -> str:
        """The change with its interval."""
        if self.kind == "gain":
            return f"a gain {self.value:.3g} times the model's ({self.low:.3g} to {self.high:.3g})"
        sign = 1.0 if self.value >= 0.0 else -1.0
        kind = self.kind if sign > 0.0 else {"delay": "lead time", "lag": "lead"}[self.kind]
        low, high = sorted((sign * self.low, sign * self.high))
        return f"a {kind} of {1e3 * abs(self.value):.2g} ms ({1e3 * low:.2g} to {1e3 * high:.2g} ms)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """The tests of one response at one height."""

    name: Name
    x_m: float
    p: float  # of all frequencies together
    refused: bool  # by the joint test
    f_hz: FloatArray
    p_each: FloatArray
    refused_hz: FloatArray  # single frequencies refused
    certain_hz: FloatArray  # where the response is measured to 30 %
    worst_hz: float
    worst_gain: float  # measured / model there
    worst_phase_deg: float  # measured - model
    forms: tuple[Form, ...]  # best first; empty where nothing is refused

    @property
    def failed(self) -> bool:
        """Return whether the model is refused here."""
        return self.refused or len(self.refused_hz) > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The answer."""

    explains: bool | None  # None: nothing to test
    sentence: str
    tests: tuple[Test, ...]
    from_hz: float  # range in which the plant (or what there is) is measured to 30 %; NaN: nowhere
    to_hz: float


def judge(tested: Sequence[Tested]) -> Verdict:
    """Test the responses of all heights, and put the answer into words."""
    listed = [(name, x_m, of[name], good[name]) for x_m, of, good in tested for name in ORDER if name in of]
    if not listed:
        return Verdict(
            explains=None,
            sentence="No recording in closed loop has an excitation to compare responses with.",
            tests=(), from_hz=np.nan, to_hz=np.nan,
        )  # fmt: skip
    each, joint = zip(*(chances(d) for _, _, d, _ in listed), strict=True)
    refused = holm(joint, LEVEL / 2.0)
    single = np.array(holm(np.concatenate(each).tolist(), LEVEL / 2.0), np.bool_)
    singles = np.split(single, np.cumsum([len(p) for p in each])[:-1])
    tests = tuple(
        _test(known, p_each, p, whole, refused_each)
        for known, p_each, p, whole, refused_each in zip(listed, each, joint, refused, singles, strict=True)
    )
    low, high = _range(tested)
    return Verdict(
        explains=not any(test.failed for test in tests),
        sentence=_sentence(tests, low, high, len(tested)),
        tests=tests,
        from_hz=low,
        to_hz=high,
    )


def _test(
    known: tuple[Name, float, Deviations, BoolArray], p_each: FloatArray, p: float, refused: bool, single: BoolArray
) -> Test:
    name, x_m, d, certain = known
    # The least probable, not the largest difference: where the noise is large, a large difference says little.
    worst = int(np.argmin(p_each))
    ratio = complex(1.0 + d.z[worst] / d.predicted[worst])
    return Test(
        name=name,
        x_m=x_m,
        p=p,
        refused=refused,
        f_hz=d.f_hz,
        p_each=p_each,
        refused_hz=d.f_hz[single],
        certain_hz=d.f_hz[certain],
        worst_hz=float(d.f_hz[worst]),
        worst_gain=abs(ratio),
        worst_phase_deg=float(np.degrees(np.angle(ratio))),
        forms=tuple(forms(d)) if refused or single.any() else (),
    )


def forms(d: Deviations) -> list[Form]:
    """Return gain, delay and lag fitted to a difference by weighted least squares, the best first."""
    bounds = {"gain": (0.2, 5.0), "delay": (-LONGEST_S, LONGEST_S), "lag": (-LONGEST_S, LONGEST_S)}
    # As if the parameters' part were independent over frequency: this weights the fit only, and `chances` tests.
    weight = 1.0 / (d.variance + np.sum(np.abs(d.slopes) ** 2, axis=1))

    def left(kind: str, value: float) -> ComplexArray:
        return np.asarray(d.z - d.predicted * (_change(kind, value, d.f_hz) - 1.0))

    def size(value: float, kind: str) -> float:
        return float(weight @ np.abs(left(kind, value)) ** 2)

    result = []
    for kind, ends in bounds.items():
        # Each form has one number, so a bounded search needs neither a starting value nor a gradient.
        fitted = minimize_scalar(size, bounds=ends, args=(kind,), method="bounded", options={"xatol": 1e-7})
        value, step = float(fitted.x), 1e-3 if kind == "gain" else 1e-5
        slope = (left(kind, value - step) - left(kind, value + step)) / (2.0 * step)
        std = float((2.0 * weight @ np.abs(slope) ** 2) ** -0.5)
        p_left = chances(replace(d, z=left(kind, value)))[1]
        result.append(Form(kind=kind, value=value, low=value - Z_95 * std, high=value + Z_95 * std, p_left=p_left))
    return sorted(result, key=lambda form: -form.p_left)


def _change(kind: str, value: float, f_hz: FloatArray) -> ComplexArray:
    """Return the factor on a response; a negative lag is a lead."""
    s = 2j * np.pi * f_hz
    if kind == "gain":
        return np.full(len(s), value, dtype=complex)
    if kind == "delay":
        return np.asarray(np.exp(-s * value))
    # 1 / (1 - s T) would have an unstable pole, so a lead is 1 + s T.
    return np.asarray(1.0 / (1.0 + s * value) if value >= 0.0 else 1.0 - s * value)


def _range(tested: Sequence[Tested]) -> tuple[float, float]:
    """The lowest and the highest frequency at which x / u_c is certain."""
    certain = [of["plant"].f_hz[good["plant"]] for _, of, good in tested if "plant" in of]
    every = np.concatenate(certain) if certain else np.empty(0)
    return (float(every.min()), float(every.max())) if len(every) else (np.nan, np.nan)


def _sentence(tests: Sequence[Test], low: float, high: float, heights: int) -> str:
    where = f"at {low:.2g} to {high:.2g} Hz" if np.isfinite(low) else "at the excited frequencies"
    failed = [test for test in tests if test.failed]
    if not failed:
        smallest = min(test.p for test in tests)
        count = sum(len(test.f_hz) for test in tests)
        at = "one height" if heights == 1 else f"{heights} heights"
        return (
            f"The model explains the loop {where}: {count} comparisons of {len(tests)} responses at {at}, "
            f"smallest p of a response {smallest:.2g}."
        )
    first = min(failed, key=lambda test: (ORDER.index(test.name), test.p))
    also = ""
    if names := [name for name in ORDER if name != first.name and any(test.name == name for test in failed)]:
        also = f" It is refused in {' and '.join(WORDS[name] for name in names)}, too."
        total = min((test for test in failed if test.name == "plant"), key=lambda test: test.p, default=first)
        if total is not first and total.forms[0].p_left > LEVEL:
            also += f" From u_c to x, {total.forms[0].text} would explain the difference."
    return f"The model does not explain the loop {where}: {clause(first)}.{also}"


def clause(test: Test) -> str:
    """A clause on one difference: where, of what, how much, and as what."""
    gain, phase = test.worst_gain, test.worst_phase_deg
    # Radians and the logarithm of the gain are the two parts of ln H, so they can be compared.
    if abs(np.radians(phase)) > abs(np.log(gain)):
        how = "lags" if phase < 0.0 else "leads"
        what = f"the measured phase of {WORDS[test.name]} {how} the model's by {abs(phase):.2g} degrees"
    else:
        how = "higher" if gain > 1.0 else "lower"
        what = f"the measured gain of {WORDS[test.name]} is {100.0 * abs(gain - 1.0):.2g} % {how} than the model's"
    places = f"{_where(test)}{what} (at {test.worst_hz:.3g} Hz)"
    good = [form for form in test.forms if form.p_left > LEVEL]
    if good:
        return f"{places}; {' or '.join(form.text for form in good)} would explain it"
    return f"{places}; no gain, delay or lag alone explains it, the nearest is {test.forms[0].text}"


def _where(test: Test) -> str:
    """The frequencies that are refused one by one; '' if only all together are."""
    wrong = test.refused_hz
    if not len(wrong):
        return "no single frequency stands out, but over all of them "
    every = np.union1d(test.certain_hz, wrong)  # what is not measured cannot be refused
    if len(np.unique(wrong)) == len(every):
        return f"at {every[0]:.2g} to {every[-1]:.2g} Hz "
    low, high = float(wrong.min()), float(wrong.max())
    between = np.count_nonzero((every >= low) & (every <= high))
    if between > 2 * len(np.unique(wrong)):  # scattered
        return f"at {', '.join(f'{f:.3g}' for f in wrong)} Hz "
    if high >= every[-1]:
        return f"above {low:.2g} Hz "
    if low <= every[0]:
        return f"below {high:.2g} Hz "
    return f"at {low:.2g} to {high:.2g} Hz " if high > low else f"at {low:.2g} Hz "
