"""The figures of the report, those of the paper among them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.distributions import student_quantile
from twin.estimation.record import FloatArray
from twin.estimation.step_figures import LoopRun, Response
from twin.page.figures import MEASURED, MODEL, REFERENCE, grid, label, legend_above, styled, ticks_125
from twin.validation.amplifier import Amplifier, AmplifierTrace
from twin.validation.ball import Ahead, Windows
from twin.validation.residuals import Channel

DURATION_S = 4.0  # of a closed loop
MAX_TRACES = 3


@styled
def amplifier_figure(result: Amplifier, time_constant_s: float) -> Figure:
    """Draw the paper's figure 7: the amplifier."""
    traces = sorted(result.traces, key=lambda t: -float(np.ptp(t.u_c_v)))[:MAX_TRACES]
    figure, axes = grid(2, len(traces), height=5.0, ratios=[2.2, 1.0])
    for n, trace in enumerate(traces):
        part = _around_change(trace, time_constant_s)
        t = (trace.t_s[part] - trace.t_s[part.start]) * 1e3
        axes[0][n].plot(t, trace.measured_a[part], color=MEASURED, lw=0.8, marker=".", ms=3, label="measured")
        axes[0][n].plot(t, trace.simulated_a[part], color=MODEL, lw=1.4, label="(1)")
        axes[1][n].step(t, trace.u_c_v[part], color=REFERENCE, lw=1.0, where="post")
        axes[0][n].set_title(trace.name, pad=20)
        axes[1][n].set_xlabel("time [ms]")
    axes[0][0].set_ylabel("current i_c [A]")
    axes[1][0].set_ylabel("input u_c [V]")
    legend_above(axes[0][0])
    return figure


@styled
def ball_figure(result: Windows, travel_m: float) -> Figure:
    """Draw the paper's figure 8, the ball, in windows."""
    figure, axes = grid(2, 1, height=5.0, ratios=[2.4, 1.0])
    top, bottom = axes[0][0], axes[1][0]
    top.plot(result.t_s, result.measured_m * 1e3, color=MEASURED, lw=2.6, label="measured")
    top.plot(result.t_s, result.simulated_m * 1e3, color=MODEL, lw=1.2, label="(6), each window from a fresh estimate")
    top.set_ylabel("position x [mm]")
    _within_travel(top, travel_m)
    legend_above(top)
    error = (result.measured_m - result.simulated_m) * 1e6
    bottom.plot(result.t_s, error, color=MODEL, lw=0.9)
    bottom.axhline(0.0, color="black", lw=0.6)
    bottom.set(xlabel="time [s]", ylabel="error [µm]")
    return figure


@styled
def ahead_figure(rows: Sequence[Ahead]) -> Figure:
    """Draw the errors over the horizon."""
    figure, axes = grid(1, 1, height=3.6, width=6.4)
    ax = axes[0][0]
    h = np.array([row.horizon_s for row in rows]) * 1e3
    ax.loglog(h, [row.still_m * 1e6 for row in rows], color=REFERENCE, ls=":", marker=".", label="constant x")
    ax.loglog(h, [row.rmse_m * 1e6 for row in rows], color=MODEL, marker="o", label="model")
    ax.loglog(h, [row.floor_m * 1e6 for row in rows], color="black", ls="--", marker="_", label="noise floor")
    ax.set_xticks(h, [f"{value:g}" for value in h])
    ax.minorticks_off()
    _extend_to_two_ticks(ax)
    label(ax, "prediction horizon [ms]", "rms error of x [µm]")
    return figure


@styled
def residual_figure(channels: Sequence[Channel]) -> Figure:
    """Draw auto- and cross-correlation with their 99 % bounds."""
    figure, axes = grid(2, len(channels), height=5.0)
    for n, channel in enumerate(channels):
        for row, values, title in (
            (0, channel.autocorrelation, f"autocorrelation of e({channel.name})"),
            (1, channel.cross_correlation, f"e({channel.name}) with u_c, so many samples earlier"),
        ):
            ax = axes[row][n]
            lags = np.arange(1, len(values) + 1)
            ax.axhspan(-channel.bound, channel.bound, color=MEASURED, alpha=0.18, lw=0, label="99 %, one lag")
            ax.axhline(0.0, color="black", lw=0.6)
            ax.vlines(lags, 0.0, values, color=MODEL, lw=1.6)
            ax.plot(lags, values, "o", color=MODEL, ms=3)
            span = max(1.25 * float(np.max(np.abs(values))), 2.0 * channel.bound)
            ax.set_ylim(-span, span)
            ax.set_title(title, pad=20 if row == 0 else None)
            ax.set_ylabel("correlation [-]")
        axes[1][n].set_xlabel("lag [samples]")
    legend_above(axes[0][0])
    return figure


@styled
def loop_figure(run: LoopRun, travel_m: float) -> Figure:
    """Draw the paper's figures 11 and 12 over one another."""
    part = _busiest(run)
    t = run.t_s[part]
    figure, axes = grid(4, 1, height=8.4, ratios=[2.4, 1.2, 1.2, 1.0])
    x, error, i, u = (axes[n][0] for n in range(4))
    simulated = bool(np.isfinite(run.quiet_x_m).any())
    if simulated:
        x.plot(t, run.simulated_x_m[0][part] * 1e3, color=MODEL, lw=1.2, label="simulated with noise")
    x.plot(t, run.x_m[part] * 1e3, color=MEASURED, lw=1.2, label="measured")
    x.plot(t, run.x_ref_m[part] * 1e3, color=REFERENCE, lw=1.0, ls="--", label="reference")
    x.set_ylabel("position x [mm]")
    _within_travel(x, travel_m)
    legend_above(x)
    against, label = (run.quiet_x_m, "measured - noise-free simulation") if simulated else (run.x_ref_m, "x - x_ref")
    error.plot(t, (run.x_m - against)[part] * 1e6, color=MEASURED, lw=0.7, label=label)
    if np.isfinite(run.expected_std_m):
        band = 2.0 * run.expected_std_m * 1e6
        error.axhspan(-band, band, color=REFERENCE, alpha=0.2, lw=0, label="2 standard deviations of noise alone")
    error.set_ylabel("error [µm]")
    legend_above(error)
    i.plot(t, run.simulated_i_c_a[0][part], color=MODEL, lw=0.7)
    i.plot(t, run.i_c_a[part], color=MEASURED, lw=0.7)
    i.set_ylabel("current i_c [A]")
    u.plot(t, run.simulated_u_c_v[0][part], color=MODEL, lw=0.6)
    u.plot(t, run.u_c_v[part], color=MEASURED, lw=0.6)
    u.set(xlabel="time [s]", ylabel="input u_c [V]")
    x.set_title(run.name, loc="right")
    return figure


@styled
def step_figure(responses: Sequence[Response]) -> Figure:
    """Draw all reference steps over one another, each scaled to 1, to show which of the two is later."""
    figure, axes = grid(2, 1, height=5.6, width=8.0, ratios=[2.0, 1.0])
    top, bottom = axes[0][0], axes[1][0]
    n = min(len(r.t_s) for r in responses)
    t = responses[0].t_s[:n] * 1e3
    rig = np.array([r.rig[:n] for r in responses])
    simulation = np.array([r.simulation[:n] for r in responses])
    difference = 100.0 * (rig - simulation)
    top.plot(t, rig.T, color=MEASURED, lw=0.4, alpha=0.25)
    top.plot(t, simulation.mean(axis=0), color=MODEL, lw=1.6, label="simulated, mean")
    top.plot(t, rig.mean(axis=0), color=MEASURED, lw=1.6, label="measured, mean (thin: each step)")
    top.axhline(1.0, color=REFERENCE, lw=0.8, ls="--")
    top.set_ylabel("share of the step [-]")
    legend_above(top)
    bottom.plot(t, difference.mean(axis=0), color=MEASURED, lw=1.2, label="rig - simulation")
    if len(responses) > 1:
        half = student_quantile(0.975, len(responses) - 1) * difference.std(axis=0, ddof=1) / np.sqrt(len(responses))
        middle = difference.mean(axis=0)
        bottom.fill_between(t, middle - half, middle + half, color=MEASURED, alpha=0.25, lw=0, label="95 % interval")
    bottom.axhline(0.0, color="black", lw=0.6)
    label(bottom, "time from the change of the reference [ms]", "difference [% of step]")
    return figure


def _within_travel(ax: Axes, travel_m: float) -> None:
    """Limit the position axis to the travel and 5 % of it at each end."""
    low, high = ax.get_ylim()
    room = 0.05 * travel_m * 1e3
    ax.set_ylim(max(low, -room), min(high, travel_m * 1e3 + room))


def _extend_to_two_ticks(ax: Axes) -> None:
    """Extend a logarithmic axis from a tick (1, 2, 5, 10 ...) below the values to one above."""
    steps = [m * 10.0**k for k in range(-4, 8) for m in (1, 2, 5)]
    low, high = ax.dataLim.intervaly
    below = max((s for s in steps if s < low), default=steps[0])
    above = min((s for s in steps if s > high), default=steps[-1])
    ax.set_ylim(0.9 * below, 1.1 * above)
    ticks_125(ax, below, above)


def _busiest(run: LoopRun) -> slice:
    n = min(round(DURATION_S / run.interval_s), len(run.t_s))
    # The way of the reference so far: the window with the largest difference has the most motion.
    moves = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(run.x_ref_m)))))
    starts = np.arange(0, len(run.t_s) - n + 1, max(n // 8, 1))
    best = int(starts[int(np.argmax(moves[starts + n - 1] - moves[starts]))])
    return slice(best, best + n)


def _around_change(trace: AmplifierTrace, time_constant_s: float) -> slice:
    """The largest step, with as much around it as (1) takes to settle twice."""
    interval = float(np.median(np.diff(trace.t_s)))
    changes: FloatArray = np.abs(np.diff(trace.u_c_v))
    k = int(np.argmax(changes)) if len(changes) else 0
    room = max(round(12.0 * time_constant_s / interval), 30)
    return slice(max(k - room // 4, 0), min(k + room, len(trace.t_s)))
