"""The paper's figure 7: i_c measured, and simulated by (1) in open loop from the recorded u_c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin.estimation.record import FloatArray, intervals, runs
from twin.estimation.step_figures import (
    FIGURES,
    SMALLEST_SIGMAS,
    Compared,
    Step,
    compared,
    measure,
    settling_band,
    together,
)
from twin.model.parameters import Model
from twin.validation.extended import current
from twin.validation.source import Source, chosen

FEWEST = 20  # samples of a level
REALISATIONS = 8  # of the sensor noise added to (1)
FLAT_SHARE = 2e-3  # of the range of u_c: a smaller change does not end a level
# name: (title, unit, factor from SI)
CURRENT_FIGURES: dict[str, tuple[str, str, float]] = {
    **{name: FIGURES[name] for name in ("rise_s", "settling_s", "overshoot")},
    "iae_m_s": ("IAE to the final level", "mA s", 1e3),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplifierTrace:
    """A stretch, measured and simulated; arrays of shape (n,); time from its beginning."""

    name: str
    t_s: FloatArray
    u_c_v: FloatArray
    measured_a: FloatArray
    simulated_a: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplifier:
    """Figure 7 in numbers."""

    traces: tuple[AmplifierTrace, ...]
    fit_percent: float  # 100 (1 - |y - y_sim| / |y - mean y|), as `compare` of MATLAB
    rmse_a: float
    noise_a: float  # standard deviation of the current sensor: rmse of a right model
    from_steps: bool  # whether the data are amplifier steps; otherwise any recording with u_c and i_c
    fitted: bool  # whether the data have use = "fit"
    steps: tuple[Compared, ...]  # measured against (1), step by step; empty without steps of u_c


def fit_percent(error: FloatArray, centred: FloatArray) -> float:
    """Return the NRMSE fit in percent, as `compare` of MATLAB; NaN for a constant signal.

    `centred`: the measured signal without its mean.
    """
    spread = float(np.linalg.norm(centred))
    return 100.0 * (1.0 - float(np.linalg.norm(error)) / spread) if spread > 0.0 else float("nan")


def amplifier(sources: Sequence[Source], model: Model) -> Amplifier | str:
    """Compare the amplifier of `model` with the recordings; a string gives the reason if that is not possible."""
    # Recordings of the amplifier alone come first: in flight the voltage that the moving ball induces may show in i_c.
    stepped = [s for s in sources if s.record.kind == "amplifier-step" or s.record.captures]
    usable = stepped or [s for s in sources if s.record.has("u_c", "i_c")]
    if not usable:
        return "no recording has both u_c and i_c"
    judges, fitted = chosen(usable)
    traces = [trace for source in judges for trace in _traces(source, model)]
    if not traces:
        return "no stretch of u_c and i_c without gaps"
    # Each trace is compared with its own mean: differences between recordings must not count as explained.
    errors = np.concatenate([t.measured_a - t.simulated_a for t in traces])
    centred = np.concatenate([t.measured_a - t.measured_a.mean() for t in traces])
    noise_a = float(np.hypot(model.noise.sigma_i_c_a, max(s.record.lsb[0] for s in judges) / np.sqrt(12.0)))
    return Amplifier(
        traces=tuple(traces),
        fit_percent=fit_percent(errors, centred),
        rmse_a=float(np.sqrt(np.mean(errors**2))),
        noise_a=noise_a,
        from_steps=bool(stepped),
        fitted=fitted,
        steps=_steps(traces, noise_a),
    )


def _steps(traces: Sequence[AmplifierTrace], noise_a: float) -> tuple[Compared, ...]:
    """Return the rise time, settling time, overshoot and IAE of every step of u_c between two constant levels.

    Sensor noise is added to the simulation, because noise increases overshoot and IAE.
    """
    # A fixed seed: the same model and campaign give the same page.
    rng = np.random.default_rng(1)
    measured: list[list[float]] = []
    simulated: list[list[float]] = []
    bands: list[float] = []
    for trace in traces:
        T_s = float(np.median(np.diff(trace.t_s)))
        is_flat = np.concatenate(([True], np.abs(np.diff(trace.u_c_v)) <= FLAT_SHARE * max(np.ptp(trace.u_c_v), 1e-12)))
        levels = runs(np.asarray(is_flat), FEWEST)
        for before, after in pairwise(levels):
            # A ramp between two levels is no step: its rise time would be that of the ramp.
            if after.start - before.stop > 1:
                continue
            noisy = trace.simulated_a + noise_a * rng.standard_normal((REALISATIONS, len(trace.simulated_a)))
            several = []
            for i in (trace.measured_a, *noisy):
                last = i[after.start : after.stop]
                # Means, not single samples: the noise of one sample would shift overshoot and IAE of the whole step.
                low, high = float(np.mean(i[before][-FEWEST:])), float(np.mean(last[-max(len(last) // 4, 4) :]))
                step = Step(begin=before.stop, end=after.stop, from_m=low, to_m=high)
                if abs(high - low) > SMALLEST_SIGMAS * noise_a:
                    several.append(measure(i, trace.u_c_v, np.full(len(i), high), step, T_s, noise_a, smooth_s=T_s))
            # The rig and all realisations, or none: a mean over those that show the step would be biased.
            if len(several) > REALISATIONS:
                bands.append(settling_band(step.to_m - step.from_m, noise_a))
                measured.append(several[0])
                simulated.append(np.mean(several[1:], axis=0).tolist())
    if not measured:
        return ()
    return together(
        [
            compared(name, np.array(measured)[:, n], np.array(simulated)[:, n], bands if name == "settling_s" else ())
            for n, name in enumerate(FIGURES)
            if name in CURRENT_FIGURES
        ]
    )


def _traces(source: Source, model: Model) -> list[AmplifierTrace]:
    record = source.acting
    traces = []
    for n, capture in enumerate(record.captures):
        first = max(capture.step_index - 200, 0)
        measured = np.asarray(capture.i_c_a[first:], dtype=float)
        u = np.full(len(measured), capture.u_to_v)
        u[: capture.step_index - first] = capture.u_from_v
        step = np.full(len(measured), capture.sample_time_s)
        # The simulation starts at the mean of the steady i_c before the step, and not at one noisy sample.
        start = float(measured[: max(capture.step_index - first, 1)].mean())
        traces.append(_trace(f"{record.name}, capture {n + 1}", u, measured, step, start, model))
    if traces or not record.has("u_c", "i_c"):
        return traces
    step, follows = intervals(record.t)
    known = np.isfinite(record.u_c) & np.isfinite(record.i_c)
    chain = known.copy()
    # Behind an unknown sample a new piece begins anyway, so the gap in time before it does not matter.
    chain[1:] &= follows[1:] | ~known[:-1]
    for piece in runs(np.asarray(chain), 50):
        u, i, x = record.u_c[piece], record.i_c[piece], np.nan_to_num(record.x[piece])
        traces.append(_trace(record.name, u, i, step[piece], float(i[0]), model, x))
    return traces


def _trace(
    name: str,
    u: FloatArray,
    measured: FloatArray,
    step: FloatArray,
    start: float,
    model: Model,
    x: FloatArray | None = None,
) -> AmplifierTrace:
    if model.causes:
        simulated = current(u, step, start, np.zeros(len(u)) if x is None else x, model, captured=x is None)
    else:
        simulated = np.empty(len(u))
        simulated[0] = i = start
        # (1) exactly, under a held u_c.  Euler's rule would diverge where T_A is below half of the step, as on a CE
        # 152.
        decay = np.exp(-step / model.T_A)
        for k in range(1, len(u)):
            e = model.K_A * u[k - 1]
            simulated[k] = i = e + (i - e) * decay[k]
    t = np.concatenate(([0.0], np.cumsum(step[1:])))
    return AmplifierTrace(name=name, t_s=t, u_c_v=u, measured_a=measured, simulated_a=simulated)
