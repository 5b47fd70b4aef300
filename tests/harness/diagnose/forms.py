"""Effects of the catalogue, written as other textbooks write them: is the effect named whatever its formula?

None of these formulas is in the other two plants; their equations are in `textbook_plant.py`.
A strength is chosen so that the effect is about as large as a medium or strong one of the catalogue.

Rule 1: a form is held out where no shape of the catalogue's cause is this formula; the others are, at some value of
        their shape, or nearer than these data can tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """A formula: its effect, its range of strengths and its source."""

    effect: str  # of the catalogue
    medium: float
    strong: float
    unit: str
    meaning: str
    source: str
    held_out: bool = False  # no shape of the catalogue is this formula


def _form(
    effect: str, strengths: tuple[float, float], unit: str, meaning: str, source: str, *, held_out: bool = False
) -> Form:
    return Form(
        effect=effect,
        medium=strengths[0],
        strong=strengths[1],
        unit=unit,
        meaning=meaning,
        source=source,
        held_out=held_out,
    )


# fmt: off
FORMS: Mapping[str, Form] = MappingProxyType({
    "saturation-froehlich": _form(
        "core-saturation", (12.0, 6.0), "A", "field i / (1 + i / i_s)",
        "O. Froehlich, Elektrotechnische Zeitschrift 2, 1881"),
    "saturation-arctan": _form(
        "core-saturation", (3.0, 2.0), "A", "field (2 i_s / pi) atan(pi i / (2 i_s))",
        "the arctangent, a usual fit of a magnetisation curve",
        held_out=True),
    "gap-exponential": _form(
        "force-exponent", (2.6e-3, 2.0e-3), "m", "force K i^2 exp(-(gap - mid) / l)",
        "INTECO, Magnetic Levitation System MLS user's manual, electromagnet model"),
    "gap-rational": _form(
        "force-exponent", (20e-3, 8e-3), "m", "force K i^2 / (gap^2 (1 + (gap - mid) / l)), a cubic polynomial below",
        "a polynomial of the gap under i^2, a usual fit of measured forces",
        held_out=True),
    "eddy-force": _form(
        "eddy-current-lag", (1.5e-3, 3e-3), "s", "the force follows its static value with one time constant",
        "the lag of eddy currents, taken for the force as a whole"),
    "eddy-flux": _form(
        "eddy-current-lag", (1.5e-3, 3e-3), "s", "the flux i / gap is held back, and the force is its square",
        "R. L. Stoll, The Analysis of Eddy Currents, 1974, one time constant of the flux"),
    "eddy-two-times": _form(
        "eddy-current-lag", (2e-3, 4e-3), "s", "65 % of the field with tau, 35 % with tau / 5",
        "J. Cauer, ladder of a lamination, cut off after two members",
        held_out=True),
    "friction-stribeck": _form(
        "coulomb-friction", (0.002, 0.006), "N", "dry friction, half as much again below 5 mm/s",
        "R. Stribeck 1902, as in B. Armstrong-Helouvry, Control of Machines with Friction, 1991"),
    "friction-lugre": _form(
        "coulomb-friction", (0.002, 0.006), "N", "bristles that bend by 5 um before they slip",
        "C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE Trans. Automatic Control 40(3), 1995",
        held_out=True),
    "resistance-heats": _form(
        "amplifier-gain-drift", (0.06, 0.15), "1/A^2", "R grows: K_A / (1 + a w) and T_A / (1 + a w)",
        "A. E. Fitzgerald, C. Kingsley, S. D. Umans, Electric Machinery, 2003",
        held_out=True),
    "dead-zone-soft": _form(
        "amplifier-dead-zone", (0.15, 0.4), "V", "K_A s ln(1 + exp((u - w) / s)), s = w / 5",
        "P. R. Gray, R. G. Meyer, Analysis and Design of Analog Integrated Circuits: a class-B stage",
        held_out=True),
    "limit-soft": _form(
        "current-limit", (1.15, 1.02), "A", "goal / (1 + (goal / limit)^10)^(1/10)",
        "C. Rapp, Effects of HPA-nonlinearity on a 4-DPSK/OFDM-signal, 1991: a limiter with a knee"),
    "inductance-nagurka": _form(
        "position-dependent-inductance", (1.0, 3.0), "",
        "L = L_inf + L_1 / (1 + gap / a), with the motional voltage that follows from it",
        "H. H. Woodson, J. R. Melcher, Electromechanical Dynamics I, 1968"),
    "sensor-cubic": _form(
        "position-sensor-nonlinearity", (1e-4, 3e-4), "m", "reads too low in the lower half, too high in the upper",
        "E. O. Doebelin, Measurement Systems, 2003"),
    "sensor-second-order": _form(
        "position-sensor-lag", (1e-3, 2.5e-3), "s", "second-order low-pass with damping 0.7, delay 1.4 / omega",
        "U. Tietze, Ch. Schenk, Electronic Circuits, 2008"),
    "drag-three-halves": _form(
        "quadratic-drag", (0.22, 0.9), "N (s/m)^1.5", "drag c |v|^0.5 v, between laminar and turbulent",
        "H. Schlichting, Boundary-Layer Theory, 1979"),
    "delay-jitter": _form(
        "actuation-delay", (1e-3, 1.5e-3), "s", "each input acts after a delay drawn between 0 and twice this",
        "J. Nilsson, Real-Time Control Systems with Delays, 1998",
        held_out=True),
    "saturation-tanh": _form(
        "core-saturation", (3.0, 2.0), "A", "field i_s tanh(i / i_s)",
        "the hyperbolic tangent, a usual fit of a magnetisation curve", held_out=True),
    "saturation-langevin": _form(
        "core-saturation", (2.0, 1.2), "A", "field 3 i_s (coth(i / i_s) - i_s / i)",
        "P. Langevin 1905, as in D. C. Jiles, D. L. Atherton, J. Magnetism and Magnetic Materials 61, 1986",
        held_out=True),
    "gap-polynomial": _form(
        "force-exponent", (0.3, 1.0), "", "force K i^2 / (gap^2 + size gap (gap - mid) + size (gap - mid)^2)",
        "a quadratic polynomial of the gap below i^2, a usual fit of measured forces", held_out=True),
    "friction-two-sided": _form(
        "coulomb-friction", (0.002, 0.006), "N", "dry friction, twice as much on the way down as on the way up",
        "B. Armstrong-Helouvry, Control of Machines with Friction, 1991: direction dependence", held_out=True),
    "limit-foldback": _form(
        "current-limit", (1.05, 0.98), "A", "above the limit 0.3 A less for each further ampere asked for",
        "P. Horowitz, W. Hill, The Art of Electronics, 2015: foldback current limiting"),
    "dead-zone-quadratic": _form(
        "amplifier-dead-zone", (0.15, 0.4), "V", "K_A u^2 / (4 w) below 2 w, K_A (u - w) above",
        "square law of a field-effect stage at its threshold", held_out=True),
    "inductance-exponential": _form(
        "position-dependent-inductance", (1.0, 3.0), "",
        "L = L_inf + L_1 exp(-gap / a), with the motional voltage that follows from it",
        "an exponential, a usual fit of measured inductances", held_out=True),
    "sensor-sine": _form(
        "position-sensor-nonlinearity", (1e-4, 3e-4), "m", "x + size sin(2 pi x / travel)",
        "interpolation error of a position sensor", held_out=True),
    "sensor-third-order": _form(
        "position-sensor-lag", (1e-3, 2.5e-3), "s", "three equal low-passes one behind the other",
        "U. Tietze, Ch. Schenk, Electronic Circuits, 2008", held_out=True),
    "drag-cubic": _form(
        "quadratic-drag", (6.0, 25.0), "N (s/m)^3", "drag c v^3",
        "dampers beyond their linear range", held_out=True),
    "current-two-times": _form(
        "second-time-constant", (5e-3, 15e-3), "s", "75 % of the current with T_A, 25 % with this time, side by side",
        "two loops of a magnet with a solid core, as in a step response of its current"),
    "current-creeps": _form(
        "second-time-constant", (0.1, 0.4), "s", "75 % of the current with T_A, 25 % with this time, side by side",
        "a power stage whose supply and core settle late"),
    "current-filtered": _form(
        "current-sensor-lag", (1e-3, 3e-3), "s", "i_c is read, by the law too, through a low pass of first order",
        "U. Tietze, Ch. Schenk, Electronic Circuits, 2008"),
    "eddy-diffusion": _form(
        "eddy-current-lag", (2e-3, 5e-3), "s", "field: i lagging by tau / n^2 with weight 1 / n^2, n = 1, 3, 5, 7",
        "R. L. Stoll, The Analysis of Eddy Currents, 1974: diffusion into a plate", held_out=True),
})
# fmt: on
