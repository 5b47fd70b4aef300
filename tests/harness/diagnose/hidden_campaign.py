"""A campaign folder as a user has one, recorded on a rig with an effect that nothing in the folder tells.

    make_campaign(folder, effects={"quadratic-drag": 1.0}, seed=3, plant="emulator")

Rule 1: what is drawn (rig, noise, excitation) follows from the seed; folder, file names and contents carry neither the
        seed nor the effect.  Who wants to compare keeps them.
Rule 2: one board clock runs through the whole campaign, transitions included, so that heating has a history.
        As on the board, the converter of i_c ends at 0 A: with the coil off it shows the positive half of the noise.
Rule 3: the operator looks before he records: ramp and random input are scaled to the input at which this ball leaves.

`PLAN` is the campaign; a `Bench` is a board with a rig that plays it.  The emulator's is here, the second plant's in
`second_plant.py`.
"""

from __future__ import annotations

import gzip
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.emulator.firmware_model.flash import CURRENT, INPUT, POSITION
from gateway.emulator.plant.constants import CE152, PlantConstants
from protocol.wire.messages import Mode, Shape
from tests.harness.twin.emulated_campaign import TICK_S, Lab, random_rig

FloatArray = NDArray[np.float64]
ShapeName = Literal["none", "rectangle", "sawtooth", "prbs", "multisine"]
PlantName = Literal["emulator", "independent", "textbook"]

MIDDLE_M = 2.85e-3
MAX_CONTACT_SHARE = 0.05  # of the closed loop
MAX_INPUT_V = 4.8  # K_A u stays below the 1.5 A that every rig of this kind gives
CAPTURE_S = 40e-6
CAPTURE_PRE, CAPTURE_COUNT = 250, 1000  # 10 ms before the step, 30 ms after it
_RIG, _NOISE, _PLAY, _BELIEF = 11, 12, 13, 14  # keep the draws of a seed apart
_HEADER = "t,u_c,i_c,x,x_ref"


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A test signal around `offset`; volts in open loop, metres of reference in closed loop."""

    shape: ShapeName
    offset: float
    amplitude: float = 0.0
    period: int = 1  # ticks; prbs: of one chip
    seed: int = 1


class Grounded(Exception):  # noqa: N818  an outcome of a draw, not a fault
    """The effects together are more than the loop can hold."""


class Refused(Exception):  # noqa: N818  as above
    """`board51 campaign run` did not get to its end."""


class Bench(Protocol):
    """A board with a rig, and a host that records; SI units, time of the board."""

    def idle(self, ticks: int) -> FloatArray:
        """Coil off."""

    def open_loop(self, signal: Signal, ticks: int) -> FloatArray:
        """u_c = signal; rows t, u_c, i_c, x, x_ref of the samples that arrived, shape (n, 5)."""

    def fly(self, x_m: float) -> None:
        """Put the ball to x by hand and close the loop."""

    def closed_loop(self, signal: Signal, ticks: int) -> FloatArray:
        """x_ref = signal; rows as above."""

    def capture(self, u_from_v: float, u_to_v: float) -> FloatArray:
        """i_c at 25 kHz around a step of u_c; rows t, u_c, i_c, shape (CAPTURE_COUNT, 3)."""

    def change(self, effects: Mapping[str, float]) -> None:
        """Give the rig these effects from now on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """A file of the folder."""

    name: str
    kind: str
    use: str
    rows: FloatArray


def designed_gains(rig: PlantConstants) -> tuple[float, float, float, float]:
    """K_LQI for this rig, as its designer would give it: the CE 152's for another force per volt."""
    per_volt = CE152.equilibrium_current_a(MIDDLE_M) / rig.equilibrium_current_a(MIDDLE_M)
    gain = per_volt * CE152.amplifier_gain_a_v / rig.amplifier_gain_a_v
    return (0.49, 1700.0 / gain, 17.7 / gain, -17600.0 / gain)


def draw_rig(seed: int, plant: PlantName = "emulator") -> PlantConstants:
    """The rig of this seed: a CE 152 of another day, and for the second plant one of another make."""
    rng = np.random.default_rng([_RIG, seed])
    rig = replace(
        random_rig(rng),
        position_noise_m=float(2.5e-6 * 4.8 ** rng.random()),
        current_noise_a=float(0.8e-3 * 5.0 ** rng.random()),
    )
    if plant == "emulator":
        return rig
    return replace(
        rig,
        mass_kg=float(np.round(rng.uniform(7.6e-3, 9.2e-3), 5)),
        coil_plane_above_stop_m=float(np.round(rng.uniform(1.9e-3, 3.1e-3), 6)),
    )


def believed_rig(rig: PlantConstants, seed: int) -> PlantConstants:
    """Return the rig that the loop's designer assumed: a few percent off, so that his gains do not tell the truth."""
    rng = np.random.default_rng([_BELIEF, seed])
    return replace(
        rig,
        amplifier_gain_a_v=rig.amplifier_gain_a_v * float(rng.uniform(0.97, 1.03)),
        force_constant_n_m2_a2=rig.force_constant_n_m2_a2 * float(rng.uniform(0.95, 1.05)),
    )


def make_campaign(
    folder: Path,
    *,
    effects: Mapping[str, float],
    seed: int,
    plant: PlantName,
    quick: bool = False,
    x_max: Literal["true", "travel"] = "true",
    outside: Mapping[str, float] | None = None,
    begins_with: str = "",
) -> None:
    """Write campaign.toml and its recordings.

    Args:
        folder: Made if absent.
        effects: Strength by name, as `gateway.emulator.plant.effects`.
        seed: Of the rig, its noise and the excitation.
        plant: Whose equations.
        quick: A third of the time in each recording.
        x_max: `true`: x_max of (3) as the rig has it without effects; `travel`: the coil's plane taken at the top stop.
        outside: Strength by name, as `outside.OUTSIDE`; the second plant only.
        begins_with: Name of a recording, one of `closed_loop_1` to `_8`: the effects are absent before it.

    Raises:
        Grounded: with these effects the loop does not keep the ball off its stops.
    """
    rig = draw_rig(seed, plant)
    believed = believed_rig(rig, seed)
    noise = int(np.random.default_rng([_NOISE, seed]).integers(2**31))
    bench: Bench
    if plant == "emulator":
        assert not outside, "only the second plant has them"
        bench = EmulatedBench(rig, {} if begins_with else effects, seed=noise, believed=believed)
    elif plant == "textbook":
        from tests.harness.diagnose.textbook_plant import TextbookBench

        bench = TextbookBench(rig, effects, seed=noise, believed=believed)
    else:
        from tests.harness.diagnose.second_bench import SecondBench

        now: Mapping[str, float] = {} if begins_with else effects
        bench = SecondBench(rig, now, seed=noise, believed=believed, outside=outside)
    recorded = play(bench, seed=seed, quick=quick, begins={begins_with: effects})
    share = contact_share(recorded, rig)
    if share > MAX_CONTACT_SHARE:
        raise Grounded(f"The ball is at a stop for {100 * share:.0f} % of the closed loop")
    write_campaign(folder, rig, believed, recorded, x_max=x_max)


def play(
    bench: Bench, *, seed: int, quick: bool = False, begins: Mapping[str, Mapping[str, float]] | None = None
) -> list[Recorded]:
    """All recordings of a campaign: about 90 s, or 30 s if quick.

    Args:
        bench: Who plays.
        seed: Of the excitation.
        quick: A third of the time in each recording.
        begins: Effects of the rig from a recording on, by its name.
    """
    rng = np.random.default_rng([_PLAY, seed])

    def ticks(seconds: float) -> int:
        return round(seconds / TICK_S / (3 if quick else 1))

    recorded: list[Recorded] = []

    def keep(name: str, kind: str, rows: FloatArray, use: str = "fit") -> None:
        recorded.append(Recorded(name=name, kind=kind, use=use, rows=rows))

    off = bench.idle(ticks(2.0))
    below = bench.open_loop(Signal(shape="none", offset=float(rng.uniform(1.2, 2.2))), ticks(3.0))
    keep("rest", "free", np.concatenate((off, below)))

    lift_v = _lift_off_input(bench)
    levels = ((0.0, 0.3), (0.5, 1.5), (1.5, 2.5), (2.5, 0.5), (2.5, min(1.12 * lift_v, MAX_INPUT_V)))
    for n, (u_from, u_to) in enumerate(levels, 1):
        keep(f"step_{n}", "amplifier-step", bench.capture(u_from, u_to))
    keep("step_6", "amplifier-step", bench.capture(0.9, 2.1), "judge")

    top = min(1.08 * lift_v, MAX_INPUT_V)
    ramp = Signal(shape="sawtooth", offset=top / 2, amplitude=top / 2, period=ticks(3.0))
    keep("ramp", "sawtooth", bench.open_loop(ramp, ticks(9.4)))
    high, low = min(1.2 * lift_v, MAX_INPUT_V), 0.1 * lift_v
    chips = Signal(shape="prbs", offset=(high + low) / 2, amplitude=(high - low) / 2, period=15, seed=_any_seed(rng))
    keep("open_loop", "prbs", bench.open_loop(chips, ticks(6.0)))

    bench.idle(200)
    bench.fly(MIDDLE_M)
    bench.closed_loop(Signal(shape="none", offset=MIDDLE_M), 400)
    number = 0
    for use, share in (("fit", 1.0), ("judge", 0.85)):
        wide = 1.5e-3 * (1.0 if use == "fit" else 0.8)
        for signal in (
            Signal(shape="rectangle", offset=MIDDLE_M, amplitude=0.4e-3 * share, period=800),
            Signal(shape="rectangle", offset=2.8e-3, amplitude=wide, period=1000 if use == "fit" else 900),
            Signal(shape="multisine", offset=MIDDLE_M, amplitude=1.2e-3 * share, period=1000, seed=_any_seed(rng)),
            Signal(shape="prbs", offset=MIDDLE_M, amplitude=0.45e-3 * share, period=40, seed=_any_seed(rng)),
        ):
            number += 1
            name = f"closed_loop_{number}"
            if begins and name in begins:
                bench.change(begins[name])
            keep(name, "closed-loop", bench.closed_loop(signal, ticks(8.5)), use)
    return recorded


def contact_share(recorded: list[Recorded], rig: PlantConstants) -> float:
    """Share of the closed-loop samples that are at a stop, 0 to 1."""
    x = np.concatenate([recording.rows[:, 3] for recording in recorded if recording.kind == "closed-loop"])
    return float(np.mean((x < 0.03 * rig.travel_m) | (x > 0.97 * rig.travel_m)))


def write_campaign(
    folder: Path,
    rig: PlantConstants,
    believed: PlantConstants,
    recorded: list[Recorded],
    *,
    x_max: Literal["true", "travel"] = "true",
) -> None:
    """The folder: campaign.toml with what a user knows of the rig, and one CSV.gz per recording."""
    folder.mkdir(parents=True, exist_ok=True)
    x_max_m = rig.travel_m + (rig.coil_plane_above_stop_m if x_max == "true" else 0.0)
    gains = ", ".join(f"{gain:.6g}" for gain in designed_gains(believed))
    i_0, u_0 = believed.equilibrium_current_a(MIDDLE_M), believed.equilibrium_input_v(MIDDLE_M)
    lines = [
        "[plant]",
        'name = "ce152"',
        f"mass_kg = {rig.mass_kg}",
        f"travel_m = {rig.travel_m}",
        f"x_max_m = {x_max_m:.6g}",
        f"gravity_m_s2 = {rig.gravity_m_s2}",
        "[controller]",
        'kind = "lqi"',
        f"gains = [{gains}]",
        f"operating_point = {{ i_c_a = {i_0:.6g}, x_m = {MIDDLE_M}, u_c_v = {u_0:.6g} }}",
    ]
    for recording in recorded:
        file = f"{recording.name}.csv.gz"
        (folder / file).write_bytes(_csv(recording.rows))
        lines += ["[[recording]]", f'file = "{file}"', f'kind = "{recording.kind}"', f'use = "{recording.use}"']
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


class EmulatedBench:
    """The emulated board in process: its own firmware, converters and commands."""

    def __init__(
        self, rig: PlantConstants, effects: Mapping[str, float], *, seed: int, believed: PlantConstants
    ) -> None:
        self._lab = Lab(rig, effects=dict(effects), seed=seed)
        self._lab.rig = believed  # whose gains `fly` loads
        self._next = 0  # first tick of the next recording
        self._forget()

    def idle(self, ticks: int) -> FloatArray:
        self._mode(Mode.IDLE)
        return self._record(ticks)

    def open_loop(self, signal: Signal, ticks: int) -> FloatArray:
        self._mode(Mode.OPEN_LOOP)
        self._excite(signal, on_reference=False)
        return self._record(ticks)

    def fly(self, x_m: float) -> None:
        warmth = self._lab.plant._state.w
        self._lab.fly(x_m)
        self._lab.plant._state = self._lab.plant._state._replace(w=warmth)  # a hand does not cool the coil
        self._forget()

    def closed_loop(self, signal: Signal, ticks: int) -> FloatArray:
        self._excite(signal, on_reference=True)
        return self._record(ticks)

    def capture(self, u_from_v: float, u_to_v: float) -> FloatArray:
        self._mode(Mode.OPEN_LOOP)
        began = self._lab.firmware.next_tick + 10  # rule 12: u_from for 20 ms before the first sample
        capture = self._lab.capture(u_from_v, u_to_v, pre=CAPTURE_PRE, count=CAPTURE_COUNT)
        self._forget()
        t = began * TICK_S + CAPTURE_S * np.arange(CAPTURE_COUNT)
        u = np.where(np.arange(CAPTURE_COUNT) < capture.step_index, capture.u_from_v, capture.u_to_v)
        return np.column_stack((t, u, capture.i_c_a))

    def change(self, effects: Mapping[str, float]) -> None:
        self._lab.plant.set_effects(effects)

    def _mode(self, mode: Mode) -> None:
        self._lab.request("SET_MODE", mode=int(mode))

    def _excite(self, signal: Signal, *, on_reference: bool) -> None:
        scale = POSITION if on_reference else INPUT
        self._lab.excite(
            Shape[signal.shape.upper()],
            on_reference=on_reference,
            amplitude=scale.span(signal.amplitude),
            offset=scale.to_count(signal.offset),
            period=signal.period,
            seed=signal.seed,
        )

    def _record(self, ticks: int) -> FloatArray:
        """The samples since the last recording: those during its own commands belong to it, as in a gateway's log."""
        lab, before = self._lab, self._next
        lab.run(ticks)
        self._next = lab.firmware.next_tick
        rows = [
            (
                # The line's sequence number wraps after 131 s.
                (before + ((state.sequence - before) & 0xFFFF)) * TICK_S,
                INPUT.to_si(state.u_c),
                CURRENT.to_si(state.i_c),
                POSITION.to_si(state.x),
                POSITION.to_si(state.x_ref),
            )
            for state in lab._states
        ]
        lab._states.clear()
        return np.array(rows)

    def _forget(self) -> None:
        self._lab._states.clear()
        self._next = self._lab.firmware.next_tick


def _lift_off_input(bench: Bench) -> float:
    """Input at which the ball leaves, V, found as an operator does: raised until it goes."""
    bench.open_loop(Signal(shape="none", offset=0.0), 100)
    rest = None
    for u in np.arange(2.4, MAX_INPUT_V, 0.05):
        rows = bench.open_loop(Signal(shape="none", offset=float(u)), 25)
        x = float(np.median(rows[-10:, 3]))
        rest = x if rest is None else rest
        if x > rest + 0.8e-3:
            break
    bench.open_loop(Signal(shape="none", offset=0.0), 100)
    return float(u)


def _any_seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 32768))


def _csv(rows: FloatArray) -> bytes:
    import pyarrow as pa
    from pyarrow import csv

    names = _HEADER.split(",")[: rows.shape[1]]
    # Rounded as a recorder prints: 0.1 us, 1 uV, 0.1 uA, 1 nm; a converter count is a thousand times more.
    digits = (7, 6, 7, 9, 9)
    columns = [np.round(rows[:, n], digits[n]) for n in range(len(names))]
    buffer = io.BytesIO()
    csv.write_csv(pa.table(columns, names=names), buffer, csv.WriteOptions(quoting_style="none"))
    return gzip.compress(buffer.getvalue(), compresslevel=1, mtime=0)
