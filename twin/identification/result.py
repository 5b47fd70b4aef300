"""The result of identification: the model's noise and provenance, and a table for the user."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from protocol.campaign import Campaign
from twin.estimation.prepare import Usage
from twin.estimation.record import Record
from twin.estimation.whiteness import Whiteness
from twin.evidence.starting.levels import Levels, Shape
from twin.evidence.starting.liftoff import ForceConstant
from twin.identification.horizon import Horizon
from twin.identification.starts import Starts
from twin.inference.optimiser import Fit
from twin.inference.theta import FLOORS
from twin.model.parameters import NOISE, Model, Noise
from twin.page.plain import plain

_ASSUMED = Noise(sigma_x_m=5e-6, sigma_i_c_a=2e-3, process_a_m_s2=0.02, process_i_c_a=1e-4)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """The model and the intermediate results."""

    model: Model
    converged: bool
    warnings: tuple[str, ...]
    usages: tuple[Usage, ...]
    levels: Levels | None
    shape: Shape | None
    force: ForceConstant | None
    fit: Fit | None
    whiteness: Whiteness | None
    ahead: Horizon | None  # prediction over AHEAD_S on these recordings, if the residuals are coloured
    tick_s: float  # interval of the process noise

    @property
    def usable(self) -> bool:
        """Return whether a twin can use the model: the fit converged, and K_A and K_c are known."""
        known = all(self.model.parameters[name].verdict in ("identified", "weak") for name in ("K_A", "K_c"))
        return self.converged and known


def noise_of(fitted: Fit | None, records: list[Record]) -> Noise:
    """Return the noise of the fit without the converters' quantisation, which the twin adds from the scalings."""
    values = {name: getattr(_ASSUMED, name) for name in NOISE}
    if fitted is not None:
        known = {name: fitted.theta.value(name) for name in fitted.free if name in NOISE}
        noises = ("process_i_c_a", "process_a_m_s2") if "K_c" in fitted.free else ("process_i_c_a",)
        known |= {name: FLOORS[name] for name in noises if name not in fitted.free}
        values |= known
        i_lsb, x_lsb = (max((record.lsb[n] for record in records), default=0.0) for n in (0, 1))
        for name, lsb in (("sigma_i_c_a", i_lsb), ("sigma_x_m", x_lsb)):
            if name in known:
                # The twin adds the rounding of the converter itself: left in sigma, it would count twice.
                values[name] = math.sqrt(max(values[name] ** 2 - lsb**2 / 12.0, 0.01 * values[name] ** 2))
    return Noise(**{name: min(max(values[name], low), high) for name, (low, high) in NOISE.items()})


def provenance_of(
    campaign: Campaign,
    fitted: Fit | None,
    white: Whiteness | None,
    usages: list[Usage],
    warnings: list[str],
    starts: Starts,
) -> dict[str, Any]:
    """The provenance of a model file: recordings, fit, residuals, warnings."""
    result: dict[str, Any] = {
        "campaign": campaign.plant.name,
        "recordings": [asdict(usage) for usage in usages],
        "warnings": list(dict.fromkeys(warnings)),
    }
    if fitted is not None:
        result["fit"] = {
            "criterion": "EKF innovations, maximum likelihood",
            "converged": fitted.converged,
            "passes": fitted.passes,
            "log_likelihood": fitted.loglik,
            "estimated": list(fitted.free),
        }
    if white is not None:
        result["residuals"] = plain(asdict(white))
    if (levels := starts.levels) is not None:
        result["levels"] = {
            "K_A": levels.K_A,
            "K_A_std": levels.K_A_std,
            "offset_a": levels.offset_a,
            "offset_std_a": levels.offset_std_a,
            "bend_a": levels.bend_a,
            "count": len(levels.levels),
        }
    if starts.shape is not None:
        result["amplifier_shape"] = asdict(starts.shape)
    if (force := starts.force) is not None:
        result["rest"] = {
            "K_c": force.K_c,
            "std": force.std,
            "equation": "(8)",
            "scatter": force.scatter,
            "coil_plane_above_x_max_m": force.shift_m,
            "points": [
                {"recording": p.recording, "gap_m": p.gap_m, "i_c_a": p.i_c_a, "K_c": p.K_c} for p in force.points
            ],
        }
    return result


def table(result: Identification) -> str:
    """Return the parameters, noise, residuals and warnings as lines of text."""
    lines = [f"{'':4}{'value':>12} {'unit':<10} {'std':>9}  {'95 % interval':<28}{'verdict':<18}how"]
    for name, p in result.model.parameters.items():
        interval = "-"
        if p.ci95:
            # Enough digits to show the width of the interval.
            low, high = p.ci95
            width = (high - low) / max(abs(high), 1e-300)
            digits = min(max(math.ceil(2.0 - math.log10(width)), 5), 9) if width > 0.0 else 5
            interval = f"{low:.{digits}g} .. {high:.{digits}g}"
        std = f"{p.std:.2g}" if p.std is not None else "-"
        lines.append(f"{name:<4}{p.value:>12.6g} {p.unit:<10} {std:>9}  {interval:<28}{p.verdict:<18}{p.method}")
    n = result.model.noise
    lines.append(
        f"noise: i_c {n.sigma_i_c_a * 1e3:.3g} mA, x {n.sigma_x_m * 1e6:.3g} um, unexplained acceleration "
        f"{n.process_a_m_s2:.3g} m/s^2, current {n.process_i_c_a * 1e3:.3g} mA per tick"
    )
    if result.whiteness is not None:
        w = result.whiteness
        colour = "white" if w.white else f"coloured (autocorrelation up to {w.worst:.2f}): not everything is explained"
        lines.append(f"innovations: chi2 {w.chi2_x:.2f} (x), {w.chi2_i:.2f} (i_c), {colour}")
    lines += [f"! {warning}" for warning in result.warnings]
    return "\n".join(lines)
