"""The figures of the report: measured points with bars, the model as a line with a band; grey tells them apart, too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from twin.distributions import Z_95, fisher_quantile
from twin.estimation.record import FloatArray
from twin.frequency.bode import Height, Measured
from twin.frequency.residual_psd import ResidualSpectrum
from twin.frequency.responses import TITLES, UNITS, Curve, Name
from twin.page.figures import MEASURED, MODEL, REFERENCE, grid, styled

DRAWN: tuple[Name, ...] = ("amplifier", "plant", "loop")
SENSITIVITIES: tuple[Name, ...] = ("S", "T")


def radius(m: Measured) -> FloatArray:
    """Return the radius of the disc that holds the response with 95 %, shape (F,)."""
    # F and no chi-square: the noise is an estimate from few bins, which makes the disc larger.
    return np.asarray(m.std * np.sqrt(fisher_quantile(0.95, 2.0, 2.0 * m.dof)))


@styled
def response_figure(height: Height) -> Figure:
    """Draw gain, phase and coherence of amplifier, plant and loop gain at one height."""
    names = [name for name in DRAWN if name in height.measured]
    figure, axes = grid(3, len(names), height=7.4, ratios=[2.0, 1.6, 0.9])
    for n, name in enumerate(names):
        measured, curve = height.measured[name], height.model.get(name)
        _gain(axes[0][n], measured, curve, UNITS[name])
        _phase(axes[1][n], measured, curve)
        axes[0][n].set_title(TITLES[name])
        axes[2][n].semilogx(measured.f_hz, measured.coherence, color=REFERENCE, lw=1.0, marker=".")
        axes[2][n].set(xlabel="frequency [Hz]", ylim=(0.0, 1.05))
        _plain_ticks(axes[2][n].xaxis)
        if name == "loop":
            axes[0][n].axhline(1.0, color="black", lw=0.6)
            axes[1][n].axhline(-180.0, color="black", lw=0.6)
    axes[1][0].set_ylabel("phase [degrees]")
    axes[2][0].set_ylabel("coherence [-]")
    _legend_outside(figure, axes[0][0])
    return figure


@styled
def sensitivity_figure(height: Height) -> Figure:
    """Draw the gains of S and T at one height."""
    figure, axes = grid(1, 2, height=3.4)
    for ax, name in zip(axes[0], SENSITIVITIES, strict=True):
        _gain(ax, height.measured[name], height.model.get(name), UNITS[name])
        ax.axhline(1.0, color="black", lw=0.6)
        ax.set_title(TITLES[name])
        ax.set_xlabel("frequency [Hz]")
        _plain_ticks(ax.xaxis)
    _legend_outside(figure, axes[0][0])
    return figure


@styled
def residual_figure(spectra: Sequence[ResidualSpectrum]) -> Figure:
    """Draw the spectra of the innovations against the model's noise."""
    figure, axes = grid(1, len(spectra), height=3.4)
    for ax, item in zip(axes[0], spectra, strict=True):
        ax.loglog(item.f_hz, item.power, color=MEASURED, lw=0.9, label="measured")
        ax.axhspan(item.low, item.high, color=REFERENCE, alpha=0.25, lw=0, label="95 %, one frequency")
        ax.axhline(1.0, color=MODEL, lw=1.4, label="model's noise")
        if len(item.wrong_hz):
            power = np.interp(item.wrong_hz, item.f_hz, item.power)
            ax.plot(item.wrong_hz, power, "x", color="black", ms=6, label="refused")
        ax.set_title(f"residual of {item.channel}")
        ax.set(xlabel="frequency [Hz]", ylabel="power / stated power [-]")
        _plain_ticks(ax.xaxis)
        if item.power.max() < 100.0 * item.power.min():
            _plain_ticks(ax.yaxis)
    _legend_outside(figure, max(axes[0], key=lambda ax: len(ax.get_legend_handles_labels()[1])))
    return figure


def _gain(ax: Axes, measured: Measured, curve: Curve | None, unit: str) -> None:
    # Not where the error exceeds the value: on a logarithmic axis such a bar has no lower end.
    drawn = measured.std < np.abs(measured.value)
    size, bar = np.abs(measured.value)[drawn], radius(measured)[drawn]
    if curve is not None:
        gain, spread = np.abs(curve.value), np.exp(Z_95 * curve.log_gain_std)
        ax.fill_between(curve.f_hz, gain / spread, gain * spread, color=MODEL, alpha=0.25, lw=0, label="model, 95 %")
        ax.loglog(curve.f_hz, gain, color=MODEL, lw=1.4, label="model")
    ax.errorbar(
        measured.f_hz[drawn], size, yerr=(np.minimum(bar, 0.9 * size), bar), color=MEASURED, fmt="o", ms=4, lw=1.2,
        capsize=2.5, label="measured, 95 %",
    )  # fmt: skip
    ax.set(xscale="log", yscale="log", ylabel=f"gain [{unit}]")
    low, high = ax.get_ylim()
    if high < 20.0 * low:
        _plain_ticks(ax.yaxis)


def _legend_outside(figure: Figure, ax: Axes) -> None:
    """Put one legend for all axes above them: in one of them it would cover data."""
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper left", ncols=4, frameon=False)


def _plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2, 5, 10 .. without powers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _phase(ax: Axes, measured: Measured, curve: Curve | None) -> None:
    drawn = measured.std < np.abs(measured.value)
    f_hz, phase = measured.f_hz[drawn], np.degrees(np.angle(measured.value[drawn]))
    bar = np.degrees(np.arcsin(np.minimum(radius(measured)[drawn] / np.abs(measured.value[drawn]), 1.0)))
    if curve is not None:
        line = np.degrees(np.unwrap(np.angle(curve.value)))
        line = line - 360.0 * np.ceil((np.median(line) - 90.0) / 360.0)  # an unstable plant begins at -180, not at 180
        spread = Z_95 * np.degrees(curve.phase_std)
        ax.fill_between(curve.f_hz, line - spread, line + spread, color=MODEL, alpha=0.25, lw=0)
        ax.semilogx(curve.f_hz, line, color=MODEL, lw=1.4)
        expected = np.interp(f_hz, curve.f_hz, line)  # the turn nearest to the model's
        phase = phase - 360.0 * np.round((phase - expected) / 360.0)
    ax.errorbar(f_hz, phase, yerr=bar, color=MEASURED, fmt="o", ms=4, lw=1.2, capsize=2.5)
    ax.set(xscale="log")
