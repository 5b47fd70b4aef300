"""A line in the spectrum of a sensor: a sinusoid and its harmonics, added to the reading.

    reading = sensor + sum over k = 1, 2, 3 of A_k sin(2 pi k f t + phase_k),   A_k = A h_k,   h_1 = 1

Rule 1: a harmonic is two states of the filter that turn with its frequency.  At first their variance is A_k^2 / 2, that
        of a sinusoid of unknown phase.  So no phase is a parameter, and each recording has its own (A. C. Harvey,
        Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 2.3).
Rule 2: the mains wander, and the frequency of a model is not exact: readings older than MEMORY_S have little weight.
"""

from __future__ import annotations

from twin.model.causes.cause import CauseParameter, Form, Vector

HARMONICS = 3
LARGEST_RATIO = 3.0  # of a harmonic to the first: a larger one is a line of its own
FIRST = 115, 111  # place of the amplitude in the vector c: of i_c, of x
MEMORY_S = 2.0
USUAL = "a pure sinusoid"
FORMS = (
    Form(
        name="with harmonics",
        values={"harmonic_2": 0.3, "harmonic_3": 0.3},
        source="IEC 61000-2-2: mains and what rectifies them have harmonics",
    ),
)


def line_parameters(column: int, *, unit: str, high: float, probe: float) -> tuple[CauseParameter, ...]:
    """Amplitude, frequency and relative harmonics of a line.

    Args:
        column: 0 for i_c, 1 for x.
        unit: of the reading.
        high: largest amplitude, in this unit.
        probe: a small amplitude.
    """
    first = FIRST[column]
    return (
        CauseParameter(
            name=f"amplitude_{unit.lower()}", symbol="A", unit=unit, index=first, low=0.0, high=high, probes=(probe,)
        ),
        CauseParameter(
            name="frequency_hz",
            symbol="f",
            unit="Hz",
            index=first + 1,
            neutral=50.0,
            low=1.0,
            high=1000.0,
            probes=(51.0,),
        ),
        *(
            CauseParameter(
                name=f"harmonic_{k}",
                symbol=f"h_{k}",
                index=first + k,
                low=0.0,
                high=LARGEST_RATIO,
                probes=(0.3,),
                spread=0.5,
            )
            for k in range(2, HARMONICS + 1)
        ),
    )


def harmonics(c: Vector, column: int) -> list[tuple[float, float]]:
    """Return (frequency in Hz, amplitude) of each harmonic that i_c (column 0) or x reads."""
    first = FIRST[column]
    # Harmonics are shares of the first: a line that is absent has none of them.
    amplitudes = [c[first], *(c[first] * c[first + k] for k in range(2, HARMONICS + 1))]
    return [(c[first + 1] * k, amplitude) for k, amplitude in enumerate(amplitudes, 1) if amplitude > 0.0]
