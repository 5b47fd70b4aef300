"""The evidence of one window for each cause: slope and information of its size, (S 8) of docs/theory/statistics.md.

The parameters of the twin's model, its causes and its noise levels are fitted to the window first.  So their slow drift
is no evidence, and an effect that has no name counts as noise.

Rule: each cause has its usual form and its first probe, a limit all its probes.  The forms would triple the work, and
      `diagnose` decides between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.diagnosis.search.probes import probes_of
from twin.diagnosis.search.score_test import Probe, projections
from twin.estimation.innovations import FLIES, FOLLOWS, USE_I, USE_X, Series
from twin.evidence.gather import Evidence
from twin.inference.fisher_scoring import climb
from twin.inference.likelihood import Criterion
from twin.inference.theta import BASE, FLOORS, Theta, coordinates_of
from twin.live.naming.windows import Window
from twin.model.causes.catalogue import CATALOGUE
from twin.model.parameters import Model
from twin.settings.naming import FIXED, PASSES, VISIBLE


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """The evidence for one probe of a cause."""

    cause: str
    probe: float  # value of the strength
    slope: float  # of the log-likelihood, by the size in probes
    information: float  # on that size


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowEvidence:
    """The evidence of one window; what the parameters of the model take up has no information."""

    window: Window
    theta: Theta  # of the fit
    signatures: tuple[Signature, ...]  # the same causes and numbers of probes in each window


def evidence_of(window: Window, model: Model, start: Theta | None = None) -> WindowEvidence:
    """Fit the twin's model to a window, and test each cause that it does not have.

    Args:
        window: of flight.
        model: of the twin.
        start: the fit of the window before, which halves the work; None: the model as it is.
    """
    criterion = _criterion(window, model)
    try:
        free = tuple(name for name in BASE if name not in FIXED) + tuple(
            coordinates_of(cause.name)[0] for cause in model.causes
        )
        theta = climb(criterion, start or _theta(window, model), free, passes=PASSES, approximate=True).theta
        trials = _trials(criterion.evidence.series, model)
        found = projections(criterion, theta, free, trials)
    finally:
        criterion.close()
    signatures = []
    for (cause, probe, _), projection in zip(trials, found, strict=True):
        # What the parameters take up wholly has no size: little divided by little would be any.
        seen = projection is not None and projection.visible >= VISIBLE
        slope, information = (projection.slope, projection.information) if projection and seen else (0.0, 0.0)
        signatures.append(Signature(cause=cause.name, probe=probe, slope=slope, information=information))
    return WindowEvidence(window=window, theta=theta, signatures=tuple(signatures))


def _criterion(window: Window, model: Model) -> Criterion:
    # Contiguous: for columns of a table the kernels would be compiled once more.
    u, i, x = (np.ascontiguousarray(column) for column in window.readings.T)
    flags = np.full(len(u), FOLLOWS | FLIES | USE_I | USE_X, np.uint16)
    # The first sample follows none: the filter begins there with an unknown speed.
    flags[0] &= np.uint16(~FOLLOWS & 0xFFFF)
    step = np.full(len(u), window.sample_time_s)
    series = Series(step=step, u=u, i=i, x=x, flags=flags, recording=np.zeros(len(u), np.int32))
    evidence = Evidence(
        records=(), series=series, t=np.cumsum(step), usages=(), statics=(), low_m=None, high_m=None, notes=()
    )
    return Criterion(evidence, model.plant, window.sample_time_s, workers=1)


def _theta(window: Window, model: Model) -> Theta:
    noise = model.noise
    return Theta(
        K_A=model.K_A,
        T_A=model.T_A,
        K_c=model.K_c,
        b=model.b,
        sigma_i_c_a=math.hypot(noise.sigma_i_c_a, window.i_lsb_a / math.sqrt(12.0)),
        sigma_x_m=math.hypot(noise.sigma_x_m, window.x_lsb_m / math.sqrt(12.0)),
        process_i_c_a=max(noise.process_i_c_a, FLOORS["process_i_c_a"]),
        process_a_m_s2=max(noise.process_a_m_s2, FLOORS["process_a_m_s2"]),
        causes=tuple(
            (f"{cause.name}.{name}", parameter.value)
            for cause in model.causes
            for name, parameter in cause.parameters.items()
        ),
    )


def _trials(series: Series, model: Model) -> list[Probe]:
    present = {cause.name for cause in model.causes}
    trials: list[Probe] = []
    for cause in CATALOGUE:
        if cause.name in present or cause.not_testable or cause.detector != "score-test":
            continue
        probes = probes_of(cause, series)
        # All probes of a limit: its effect begins at a size, and one probe may lie beyond what the window reached.
        trials += [(cause, probe, ()) for probe in (probes if math.isinf(cause.strength.neutral) else probes[:1])]
    return trials
