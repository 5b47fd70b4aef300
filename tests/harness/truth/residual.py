"""The residual of the paper's model at its best, and regressions on it: forward selection by BIC, PySINDy.

Two residuals, 20 ms ahead: e_x of the position, as the model predicts it, and e_i of the current, an exact first-order
lag of the recorded input.  Features are taken 20 ms earlier, from what was known then; the input until now.

Rule: a term stands for the effect that it is nearest to (`MEANS`).  A regression that finds no term finds nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocol.campaign import Use
from protocol.errors import DataError
from tests.harness.truth.flights import AHEAD, TICK_S, FloatArray, flights, stamp
from twin.api.functions import predict
from twin.estimation.record import Record
from twin.model.parameters import Model

FEATURES = ("x", "i", "v", "u", "du", "di")
BACK = 4  # samples over which a speed and a slope are taken
MAX_TERMS = 8
PYTHON = "PYSINDY_PYTHON"
INSTALL = f"python3 -m venv sindy && sindy/bin/pip install pysindy, then {PYTHON}=sindy/bin/python"
# (residual, term): the effect that leaves it; terms in PySINDy's spelling.
MEANS: Mapping[tuple[str, str], str] = {
    ("x", "1"): "constant-force",
    ("x", "x"): "air-gap-offset",
    ("x", "x^2"): "force-exponent",
    ("x", "i"): "residual-magnetism",
    ("x", "i^2"): "core-saturation",
    ("x", "x i"): "force-exponent",
    ("x", "v"): "position-sensor-lag",
    ("x", "v^2"): "quadratic-drag",
    ("x", "v|v|"): "quadratic-drag",
    ("x", "sign v"): "coulomb-friction",
    ("x", "du"): "actuation-delay",
    ("x", "di"): "eddy-current-lag",
    ("i", "1"): "amplifier-offset",
    ("i", "i"): "current-sensor-offset",
    ("i", "u"): "amplifier-dead-zone",
    ("i", "u^2"): "amplifier-dead-zone",
    ("i", "i^2"): "current-limit",
    ("i", "du"): "actuation-delay",
    ("i", "di"): "slew-rate-limit",
    ("i", "i v"): "motional-emf",
    ("i", "v"): "motional-emf",
    ("i", "x du"): "position-dependent-inductance",
    ("i", "x di"): "position-dependent-inductance",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Residuals and features of recordings, a row for each that counts and is predicted."""

    keys: Sequence[tuple[str, float]]  # recording, time in s
    x_hat: FloatArray  # of the base model, m, shape (n,)
    residuals: FloatArray  # e_x in m, e_i in A, shape (n, 2)
    features: FloatArray  # in the order of FEATURES, shape (n, 6)


@dataclass(frozen=True, slots=True, kw_only=True)
class Regression:
    """The result of a regression."""

    correction: FloatArray  # e_x of the judge rows, standardised, shape (n,)
    terms: Sequence[tuple[str, str, float]]  # residual, term, weight


def tabulate(case: Path, model: Model, use: Use) -> Table:
    """Predict with a model, and tabulate what it leaves."""
    keys: list[tuple[str, float]] = []
    columns: list[FloatArray] = []
    for record, counts in flights(case, use):
        result = predict(model, case / record.name, horizon_samples=AHEAD, campaign=case)
        x_hat = dict(zip(map(stamp, result.t_s.tolist()), result.x_hat_m.tolist(), strict=True))
        rows = np.array([r for r in np.flatnonzero(counts) if stamp(record.t[r]) in x_hat], dtype=int)
        keys += [(record.name, float(record.t[r])) for r in rows]
        predicted = np.array([x_hat[stamp(record.t[r])] for r in rows])
        columns.append(np.column_stack((predicted, predicted - record.x[rows], *_features(record, model, rows))))
    whole = np.concatenate(columns)
    return Table(keys=keys, x_hat=whole[:, 0], residuals=whole[:, 1:3], features=whole[:, 3:])


def _features(record: Record, model: Model, rows: FloatArray) -> list[FloatArray]:
    """e_i and the features of these rows."""
    gain, lag = (model.parameters[name].value for name in ("K_A", "T_A"))
    k = rows - AHEAD
    decay = np.exp(-TICK_S / lag)
    i_hat = record.i_c[k]
    for n in range(AHEAD):
        i_hat = decay * i_hat + (1.0 - decay) * gain * record.u_c[k + n]
    u_until = np.mean([record.u_c[k + n] for n in range(AHEAD)], axis=0)
    u_before = np.mean([record.u_c[k - n] for n in range(1, BACK + 1)], axis=0)
    v = (record.x[k] - record.x[k - BACK]) / (BACK * TICK_S)
    di = record.i_c[k] - record.i_c[k - BACK]
    return [i_hat - record.i_c[rows], record.x[k], record.i_c[k], v, u_until, u_until - u_before, di]


def forward_bic(fit: Table, judge: Table) -> Regression:
    """Select terms one by one as long as the Bayesian information criterion falls [Schwarz 1978].

    Residuals 20 ms ahead overlap, so n of them count as n / 10.
    """
    z, target, z_judge = standardised(fit, judge)
    library, library_judge = _library(z), _library(z_judge)
    number = len(z) / AHEAD
    terms, correction = [], np.zeros(len(z_judge))
    for channel, y in zip("xi", target.T, strict=True):
        chosen: list[str] = []
        left, coefficients = float(y @ y), np.empty(0)
        while len(chosen) < MAX_TERMS:
            trials = {name: _least_squares(library, [*chosen, name], y) for name in library if name not in chosen}
            best = min(trials, key=lambda name: trials[name][0])
            gain = number * np.log(left / trials[best][0]) - np.log(number)
            if gain <= 0.0:
                break
            left, coefficients = trials[best]
            chosen.append(best)
            terms.append((channel, best, float(gain)))
        if channel == "x" and chosen:
            correction = np.column_stack([library_judge[name] for name in chosen]) @ coefficients
    return Regression(correction=correction, terms=terms)


def pysindy(fit: Table, judge: Table) -> Regression:
    """Regress with PySINDy under the Python of PYSINDY_PYTHON, or this one.

    Raises:
        DataError: it failed; the message has its last line.
    """
    z, target, z_judge = standardised(fit, judge)
    with tempfile.TemporaryDirectory(prefix="sindy-") as scratch:
        table, out = Path(scratch) / "table.npz", Path(scratch) / "out.json"
        np.savez(
            table,
            fit_x=z[:, :2],
            fit_u=z[:, 2:],
            fit_y=target,
            judge_x=z_judge[:, :2],
            judge_u=z_judge[:, 2:],
            names=np.array(FEATURES),
        )
        command = [python_of_pysindy(), str(Path(__file__).with_name("sindy.py")), str(table), str(out)]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        if process.returncode:
            raise DataError(f"pysindy: {process.stderr.strip().splitlines()[-1:]}", remedy="Run it by hand")
        result = json.loads(out.read_text(encoding="utf-8"))
    return Regression(correction=np.array(result["correction"]), terms=[tuple(term) for term in result["terms"]])


def python_of_pysindy() -> str:
    """The Python that has pysindy."""
    return os.environ.get(PYTHON, sys.executable)


def absent_pysindy() -> str:
    """Return the reason why PySINDy cannot run; empty if it can."""
    try:
        process = subprocess.run([python_of_pysindy(), "-c", "import pysindy"], capture_output=True, check=False)
    except OSError as problem:
        return f"{python_of_pysindy()}: {problem.strerror}"
    return f"{python_of_pysindy()} has no pysindy: {INSTALL}" if process.returncode else ""


def standardised(fit: Table, judge: Table) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Features of fit, residuals of fit in standard deviations, features of judge by the same scale."""
    mean, std = fit.features.mean(axis=0), fit.features.std(axis=0)
    return (
        (fit.features - mean) / std,
        fit.residuals / fit.residuals.std(axis=0),
        (judge.features - mean) / std,
    )


def _library(z: FloatArray) -> dict[str, FloatArray]:
    columns = dict(zip(FEATURES, z.T, strict=True))
    library = {"1": np.ones(len(z)), **columns}
    for n, feature in enumerate(FEATURES):
        library[f"{feature}^2"] = columns[feature] ** 2
        library |= {f"{feature} {other}": columns[feature] * columns[other] for other in FEATURES[n + 1 :]}
    v = columns["v"]
    return library | {"v|v|": v * np.abs(v), "sign v": np.sign(v), "x^3": columns["x"] ** 3, "i^3": columns["i"] ** 3}


def _least_squares(library: Mapping[str, FloatArray], names: Sequence[str], y: FloatArray) -> tuple[float, FloatArray]:
    """The sum of squares that these terms leave, and their coefficients."""
    a = np.column_stack([library[name] for name in names])
    coefficients: FloatArray = np.asarray(np.linalg.lstsq(a, y, rcond=None)[0], dtype=np.float64)
    return max(float(np.sum((y - a @ coefficients) ** 2)), 1e-300), coefficients
