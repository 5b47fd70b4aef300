"""Compare flights of one log, each with another model in the twin: the improvements, and the remaining error.

Rule: only measured errors are reported here; `board51 diagnose` names the causes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from protocol.bus import board51_pb2 as pb
from protocol.diagnosis import Diagnosis
from protocol.files import parse_json
from protocol.log.reader import read

REST_SAMPLES = 250  # the last half second at a reference, at which only the balance of forces matters
NOTABLE_A = 5e-3  # the noise of i_c is 2 mA a sample, 0.1 mA in a mean over REST_SAMPLES


@dataclass(slots=True)
class Flight:
    """A part of the log with one model in the twin."""

    name: str
    from_t_s: float
    to_t_s: float
    rest: dict[float, list[tuple[float, float]]] = field(default_factory=dict)  # x_ref, mm: i_c of rig and twin, A
    innovations: list[tuple[float, float, float]] = field(default_factory=list)  # of x, i_c; NIS
    alarms: list[str] = field(default_factory=list)
    allowed_m_s2: float = math.nan  # process noise of the model in the twin, which raises the thresholds of alarms

    def currents(self) -> dict[float, tuple[float, float]]:
        """Return i_c of rig and twin at rest in A, by reference in mm."""
        result = {}
        for x_ref, pairs in sorted(self.rest.items()):
            rest = pairs[-REST_SAMPLES:]
            result[x_ref] = sum(i for i, _ in rest) / len(rest), sum(i for _, i in rest) / len(rest)
        return result

    def innovation(self) -> tuple[float, float, float]:
        """Return (rms of the one-step innovation of x in m, of i_c in A, mean NIS); NaN without innovations."""
        n = len(self.innovations)
        if not n:
            return math.nan, math.nan, math.nan
        x, i, nis = (
            sum(column) / n for column in zip(*((a * a, b * b, c) for a, b, c in self.innovations), strict=True)
        )
        return math.sqrt(x), math.sqrt(i), nis


def gather(log: Path, flights: list[Flight]) -> None:
    """Fill the flights from the log.  Raises DataError if it cannot be read."""
    allowed_m_s2 = math.nan
    states: dict[tuple[int, int], pb.State] = {}
    for record in read(log, topics=["state", "twin/state", "twin/divergence", "twin/alarm", "twin/model"]):
        message = record.message
        if isinstance(message, pb.TwinModel):
            allowed_m_s2 = float(
                parse_json(message.model_json, where=f"{log}: the twin's model")["noise"]["process_a_m_s2"]
            )
            continue
        if isinstance(message, pb.State):
            if message.mode == pb.MODE_CLOSED_LOOP:
                states[message.session, message.tick] = message
            continue
        if not isinstance(message, pb.TwinState | pb.Divergence | pb.Alarm):
            continue
        state = states.get((message.session, message.tick))
        flight = next((f for f in flights if state and f.from_t_s <= state.t_s < f.to_t_s), None)
        if state is None or flight is None:
            continue
        flight.allowed_m_s2 = allowed_m_s2
        if isinstance(message, pb.TwinState) and message.sync == "in-step":
            pairs = flight.rest.setdefault(round(state.x_ref_m * 1e3, 2), [])
            pairs.append((state.i_c_a, message.i_c_a))
        elif isinstance(message, pb.Divergence) and message.innovation_valid:
            flight.innovations.append((message.innovation_x_m, message.innovation_i_c_a, message.nis))
        elif isinstance(message, pb.Alarm) and message.active:
            flight.alarms.append(message.name)


def table(flights: Sequence[Flight]) -> str:
    """A table that compares each twin with the rig."""
    currents = [flight.currents() for flight in flights]
    lines = [
        f"  {'held at':>10}{'rig':>9}" + "".join(f"   {'twin, ' + flight.name:^22}" for flight in flights),
        f"  {'x_ref [mm]':>10}{'i_c [A]':>9}" + f"   {'i_c [A]':>10}{'error [A]':>12}" * len(flights),
    ]
    for x_ref in sorted(set.intersection(*(set(currents_of) for currents_of in currents))):
        cells = "".join(
            f"   {twin:>10.3f}{rig - twin:>+12.3f}" for rig, twin in (currents_of[x_ref] for currents_of in currents)
        )
        lines.append(f"  {x_ref:>10.2f}{currents[0][x_ref][0]:>9.3f}{cells}")

    def row(what: str, cells: list[str]) -> None:
        lines.append(f"  {what:<19}" + "".join(f"   {cell:>22}" for cell in cells))

    innovations = [flight.innovation() for flight in flights]
    row("innovation of x", [f"{x * 1e6:.1f} um" for x, _, _ in innovations])
    row("innovation of i_c", [f"{i * 1e3:.2f} mA" for _, i, _ in innovations])
    row("called noise, x''", [f"{flight.allowed_m_s2:.2g} m/s^2" for flight in flights])
    row("mean NIS (correct: 2)", [f"{nis:.3g}" for _, _, nis in innovations])
    row("alarms raised", [str(len(flight.alarms)) for flight in flights])
    return "\n".join(lines)


def sentence(flights: Sequence[Flight]) -> str:
    """A sentence on the change of the error from flight to flight, and on the error that remains."""
    errors = [[rig - twin for rig, twin in flight.currents().values()] for flight in flights]
    if not all(errors):
        return "A flight without a twin in step: nothing can be compared."
    rms = [math.sqrt(sum(e * e for e in some) / len(some)) for some in errors]
    steps = [
        f"the {flight.name} model {_verb(was, now)} from {was * 1e3:.0f} to {now * 1e3:.0f} mA rms"
        for flight, was, now in zip(flights[1:], rms, rms[1:], strict=False)
    ]
    text = f"Error of the twin's current at rest: {'; '.join(steps)}"
    last, left = flights[-1], errors[-1]
    if max(map(abs, left)) < NOTABLE_A:
        over = f"The rest is below {NOTABLE_A * 1e3:.0f} mA"
    else:
        over = f"Left over: {min(left) * 1e3:+.0f} to {max(left) * 1e3:+.0f} mA{_trend(left)}"
    names = ", ".join(dict.fromkeys(last.alarms))
    alarms = f"the {last.name} twin still raises {names}" if names else f"the {last.name} twin raises no alarm"
    if last.allowed_m_s2 > 10.0 * flights[0].allowed_m_s2:
        # With so much process noise, a twin without alarms need not be right.
        alarms += f", counting {last.allowed_m_s2:.2g} m/s^2 of acceleration as noise"
    return f"{text}. {over}; {alarms}."


def conclusion(diagnosis: Diagnosis) -> str:
    """A sentence with the causes of a diagnosis; without causes, the sentence of the diagnosis."""
    names = [f"{cause.name} ({cause.sentence})" for cause in diagnosis.causes]
    if not names:
        return f"Cause: {diagnosis.sentence}"
    rest = (
        " Another error is left, and no known cause explains it."
        if diagnosis.verdict in ("unknown-cause", "partly-explained")
        else ""
    )
    return f"Cause: {'; '.join(names)}.{rest}"


def _verb(was: float, now: float) -> str:
    return "cuts it" if now < 0.9 * was else "raises it" if now > 1.1 * was else "leaves it"


def _trend(errors: list[float]) -> str:
    """A clause on the trend of the error over height; `errors` are in order of rising references."""
    rising = all(b > a for a, b in pairwise(errors))
    falling = all(b < a for a, b in pairwise(errors))
    if len(errors) < 3 or not (rising or falling):
        return ""
    return f", {'rising' if rising else 'falling'} with the height of the ball"
