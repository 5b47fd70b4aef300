"""Sparse regression of a residual by PySINDy; runs under a Python that has pysindy, and imports nothing of ours.

    python sindy.py TABLE.npz OUT.json

TABLE: fit_x (n, 2), fit_u (n, 4), fit_y (n, 2): standardised features and residuals; judge_x, judge_u; names.
OUT: the correction of the first residual on the judge rows; terms (channel, name, share of the residual's variance).
The threshold is that of the smallest error on the last quarter of the rows.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import pysindy

THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.5)


def model_of(threshold: float, x: Any, u: Any, y: Any, names: list[str]) -> Any:
    """Fit one model."""
    model = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-3),
        feature_library=pysindy.PolynomialLibrary(degree=2),
    )
    model.fit(x, t=1.0, x_dot=y, u=u, feature_names=names)
    return model


def main(table: str, out: str) -> None:
    """Choose the threshold, fit, write."""
    data = np.load(table)
    x, u, y, names = data["fit_x"], data["fit_u"], data["fit_y"], data["names"].tolist()
    cut = 3 * len(x) // 4
    errors = []
    for threshold in THRESHOLDS:
        model = model_of(threshold, x[:cut], u[:cut], y[:cut], names)
        errors.append(float(np.mean((model.predict(x[cut:], u=u[cut:]) - y[cut:]) ** 2)))
    model = model_of(THRESHOLDS[int(np.argmin(errors))], x, u, y, names)
    terms = []
    library = np.asarray(model.feature_library.transform(np.hstack((x, u))))
    for channel, row in zip("xi", model.coefficients(), strict=True):
        for name, size, column in zip(model.get_feature_names(), row, library.T, strict=True):
            if size != 0.0:
                terms.append((channel, name, float(size**2 * (column**2).mean())))
    correction = np.asarray(model.predict(data["judge_x"], u=data["judge_u"]))[:, 0].tolist()
    with open(out, "w", encoding="utf-8") as file:
        json.dump({"correction": correction, "terms": terms}, file)


main(*sys.argv[1:])
