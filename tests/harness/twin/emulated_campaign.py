"""A whole campaign on the emulated board, in process and without waiting: what `board51 identify` is meant for.

The board's own firmware flies the ball, so counts, delays and saturations are the real ones; the records are read off
the STATE frames as a gateway would.  A random rig gets the board's gains for its own force constant, as its designer
would give it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from gateway.emulator.firmware_model.board import Firmware
from gateway.emulator.firmware_model.flash import CE152_BOARD, CURRENT, INPUT, POSITION, gains_in_counts
from gateway.emulator.plant.constants import CE152, PlantConstants
from gateway.emulator.plant.levitation import EmulatedPlant
from gateway.emulator.wiring import FaultyWiring
from protocol.campaign import Campaign, Kind, parse
from protocol.wire.codec import encode_body
from protocol.wire.decoder import State, StreamDecoder
from protocol.wire.framing import encode_frame
from protocol.wire.messages import Law, Message, Mode, Shape, Value
from tests.harness.protocol.port import take_output
from twin.estimation.record import Capture, Record

TICK_S = 2e-3
TRUTHS = ("K_A", "T_A", "K_c", "b")


def random_rig(rng: np.random.Generator) -> PlantConstants:
    """A CE 152 of another day: every parameter of the fit, the noise and the bounce are drawn."""
    return replace(
        CE152,
        amplifier_gain_a_v=float(rng.uniform(0.28, 0.31)),
        amplifier_time_constant_s=float(np.exp(rng.uniform(np.log(1e-4), np.log(1.5e-3)))),
        force_constant_n_m2_a2=float(5.607e-6 * rng.uniform(0.85, 1.15)),
        drag_n_s_m=float(rng.uniform(0.005, 0.05)),
        restitution=float(rng.uniform(0.2, 0.6)),
        position_noise_m=float(rng.uniform(3e-6, 10e-6)),
        current_noise_a=float(rng.uniform(1e-3, 3e-3)),
    )


def truth(rig: PlantConstants) -> dict[str, float]:
    return {
        "K_A": rig.amplifier_gain_a_v,
        "T_A": rig.amplifier_time_constant_s,
        "K_c": rig.force_constant_n_m2_a2,
        "b": rig.drag_n_s_m,
    }


def campaign_of(rig: PlantConstants, extra: str = "") -> Campaign:
    """The campaign file that describes the rig; x_max makes (3) exact for it."""
    text = (
        f'[plant]\nname = "ce152"\nmass_kg = {rig.mass_kg}\ntravel_m = {rig.travel_m}\n'
        f"x_max_m = {rig.travel_m + rig.coil_plane_above_stop_m}\n{extra}"
        '[[recording]]\nfile = "in memory"\nkind = "free"\nuse = "fit"\n'
    )
    return parse(text, where="campaign.toml", folder=Path())


class Lab:
    """A board with a rig on it, and a host that records."""

    def __init__(self, rig: PlantConstants, *, effects: dict[str, float] | None = None, seed: int = 0) -> None:
        self.rig = rig
        self.plant = EmulatedPlant(rig, effects or {}, seed=seed)
        self.wiring = FaultyWiring(self.plant, CE152_BOARD, seed=seed)
        self.firmware = Firmware(self.wiring)
        self._decoder = StreamDecoder()
        self._id = 0
        self._states: list[State] = []
        self._answers: list[Message] = []
        self._time = 0
        self.request("HELLO", session=7, version_min=1, version_max=1)
        self.request("SET_HOST_LOSS", policy=0, timeout=60000)

    def request(self, name: str, **fields: Value) -> Message:
        self._id = self._id % 255 + 1
        self._answers.clear()
        self.firmware.feed(encode_frame(encode_body(name, id=self._id, **fields)))
        self.run(1)
        assert self._answers, name
        assert self._answers[-1].name != "NACK", self._answers[-1]
        return self._answers[-1]

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.firmware.tick()
            for event in self._decoder.feed(take_output(self.firmware)):
                if isinstance(event, State):
                    self._states.append(event)
                elif isinstance(event, Message) and event.name != "EVENT":
                    self._answers.append(event)

    def states(self, ticks: int) -> list[State]:
        """Run; every state since the last call, those during a command included."""
        self.run(ticks)
        states, self._states = self._states, []
        return states

    def record(self, name: str, kind: Kind, ticks: int) -> Record:
        self._states.clear()
        states = self.states(ticks)
        return Record(
            name=name,
            kind=kind,
            use="fit",
            t=np.array([s.sequence * TICK_S for s in states]),
            u_c=np.array([INPUT.to_si(s.u_c) for s in states]),
            i_c=np.array([CURRENT.to_si(s.i_c) for s in states]),
            x=np.array([POSITION.to_si(s.x) for s in states]),
            x_ref=np.array([POSITION.to_si(s.x_ref) for s in states]),
        )

    def capture(self, u_from_v: float, u_to_v: float, *, pre: int = 200, count: int = 1000) -> Capture:
        u_from, u_to = INPUT.to_count(u_from_v), INPUT.to_count(u_to_v)
        self.request("CAPTURE", u_from=u_from, u_to=u_to, pre=pre, count=count)
        self.run(10 + math.ceil(count * 0.04 / 2) + 2)
        samples: list[int] = []
        while len(samples) < count:
            block = self.request("READ_CAPTURE", index=len(samples))
            data = block.values["samples"]
            assert isinstance(data, bytes)
            for a, b, c in zip(data[::3], data[1::3], data[2::3], strict=True):
                samples += [a | (b & 0x0F) << 8, b >> 4 | c << 4]
        return Capture(
            sample_time_s=40e-6,
            u_from_v=INPUT.to_si(u_from),
            u_to_v=INPUT.to_si(u_to),
            step_index=pre,
            i_c_a=np.array([CURRENT.to_si(n) for n in samples[:count]]),
        )

    def fly(self, x_m: float = 2.85e-3) -> None:
        """Put the ball at x and close the loop, with gains scaled for this rig as its designer would have."""
        rig = self.rig
        i_0 = rig.equilibrium_current_a(x_m)
        gain = CE152.equilibrium_current_a(x_m) / i_0 * CE152.amplifier_gain_a_v / rig.amplifier_gain_a_v
        gains = (0.49, 1700.0 / gain, 17.7 / gain, -17600.0 / gain)
        self.close_loop(gains, (i_0, x_m, rig.equilibrium_input_v(x_m)))

    def close_loop(
        self, gains: tuple[float, ...], point: tuple[float, float, float], *, i_c_a: float | None = None
    ) -> None:
        """Put the ball at rest at this operating point of i_c, x and u_c, and close the loop with these gains.

        `i_c_a` is the current that flows, where it is not that of the point.
        """
        k = gains_in_counts(Law.LQI, gains, point)
        self.request(
            "SET_GAINS",
            law=int(Law.LQI),
            **{f"k{n + 1}_mantissa": k.mantissas[n] for n in range(4)},
            **{f"k{n + 1}_shift": k.shifts[n] for n in range(4)},
            i_0=k.i_0,
            x_0=k.x_0,
            u_0=k.u_0,
        )
        self.request("SET_REFERENCE", x_ref=POSITION.to_count(point[1]))
        self.request("SET_MODE", mode=int(Mode.CLOSED_LOOP))
        self.plant.set_state(point[1], i_c_a=point[0] if i_c_a is None else i_c_a)

    def excite(self, shape: Shape, *, on_reference: bool, amplitude: int, offset: int, period: int, seed: int) -> None:
        self.request(
            "EXCITE",
            shape=int(shape),
            target=int(on_reference),
            amplitude=amplitude,
            offset=offset,
            period=period,
            period_end=period,
            seed=seed,
            duration=0,
        )


def run_campaign(
    rig: PlantConstants, *, seed: int, flight_s: float = 20.0, effects: dict[str, float] | None = None
) -> list[Record]:
    """Amplifier captures at three levels, a sawtooth to lift-off, multisine and PRBS on the reference."""
    lab = Lab(rig, effects=effects, seed=seed)
    lab.request("SET_MODE", mode=int(Mode.OPEN_LOOP))
    captures = tuple(lab.capture(a, b) for a, b in ((0.5, 1.5), (1.5, 2.5), (2.5, 0.5)))
    empty = np.empty(0)
    records = [
        Record(
            name="steps",
            kind="amplifier-step",
            use="fit",
            t=empty,
            u_c=empty,
            i_c=empty,
            x=empty,
            x_ref=empty,
            captures=captures,
        )
    ]
    top = rig.equilibrium_input_v(0.0) * 1.08
    middle, swing = INPUT.to_count(top / 2), INPUT.to_count(top / 2)
    lab.excite(Shape.SAWTOOTH, on_reference=False, amplitude=swing, offset=middle, period=1500, seed=1)
    records.append(lab.record("sawtooth", "sawtooth", 4400))
    lab.request("SET_MODE", mode=int(Mode.IDLE))
    lab.fly()
    lab.run(200)
    half = round(flight_s / TICK_S / 2)
    span = POSITION.span(0.9e-3)
    at = POSITION.to_count(2.85e-3)
    lab.excite(Shape.MULTISINE, on_reference=True, amplitude=span, offset=at, period=1000, seed=seed % 1000 + 1)
    records.append(lab.record("multisine", "closed-loop", half))
    lab.excite(Shape.PRBS, on_reference=True, amplitude=span // 2, offset=at, period=40, seed=seed % 1000 + 1)
    records.append(lab.record("prbs", "closed-loop", half))
    return records
