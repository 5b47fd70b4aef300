"""The fixed campaigns: nothing hidden, one cause, several, none of the catalogue's, and the two real rigs.

They are written out, not drawn: another draw of the matrix must not move them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from tests.harness.diagnose.hidden_campaign import PlantName, make_campaign
from tests.harness.twin.rig import G, M, Rig

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A campaign and the questions about it.

    `make` writes the campaign into a folder; without it `campaign` is one of the tree's own over the measured data.
    """

    name: str
    make: Callable[[Path], None] | None = None
    campaign: str = ""
    quick: bool = False
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # by command


def _hidden(
    name: str,
    seed: int,
    plant: PlantName,
    effects: Mapping[str, float] | None = None,
    outside: Mapping[str, float] | None = None,
    *,
    quick: bool = False,
) -> Case:
    make = partial(make_campaign, effects=effects or {}, seed=seed, plant=plant, quick=quick, outside=outside)
    return Case(name=name, make=make, quick=quick)


CASES: tuple[Case, ...] = (
    _hidden("null-emulator", 9001, "emulator"),
    _hidden("null-independent", 9002, "independent"),
    _hidden("null-emulator-quick", 9003, "emulator", quick=True),
    _hidden("null-independent-quick", 9004, "independent", quick=True),
    _hidden("air-gap-offset", 9011, "emulator", {"air-gap-offset": 3e-4}),
    _hidden("amplifier-dead-zone", 9012, "independent", {"amplifier-dead-zone": 0.15}),
    _hidden("amplifier-gain-drift", 9013, "emulator", {"amplifier-gain-drift": 0.06}),
    _hidden("actuation-delay", 9014, "independent", {"actuation-delay": 1e-3}),
    _hidden("coulomb-friction", 9015, "emulator", {"coulomb-friction": 0.002}),
    _hidden("constant-force", 9016, "independent", {"constant-force": -0.004}),
    _hidden("core-saturation", 9017, "emulator", {"core-saturation": 2.0}),
    _hidden("eddy-current-lag", 9018, "independent", {"eddy-current-lag": 1.5e-3}),
    _hidden("lost-samples", 9019, "emulator", {"lost-samples": 0.02}),
    _hidden("periodic-disturbance", 9020, "independent", {"periodic-disturbance": 0.002}),
    _hidden("position-sensor-lag", 9021, "emulator", {"position-sensor-lag": 1e-3}),
    _hidden("position-sensor-nonlinearity", 9022, "independent", {"position-sensor-nonlinearity": 1e-4}),
    _hidden("quadratic-drag", 9023, "emulator", {"quadratic-drag": 1.0}),
    _hidden("motional-emf", 9024, "independent", {"motional-emf": 0.2}),
    _hidden("current-limit-quick", 9025, "emulator", {"current-limit": 1.02}, quick=True),
    _hidden("sensor-crosstalk-quick", 9026, "independent", {"sensor-crosstalk": 6e-5}, quick=True),
    _hidden("two-gap-and-drag", 9031, "emulator", {"air-gap-offset": 5e-4, "quadratic-drag": 2.0}),
    _hidden("two-lag-and-offset", 9032, "independent", {"eddy-current-lag": 2e-3, "position-sensor-offset": 3e-4}),
    _hidden(
        "three-friction-force-slew",
        9033,
        "emulator",
        {"coulomb-friction": 0.003, "constant-force": 0.006, "slew-rate-limit": 60.0},
    ),
    _hidden(
        "three-exponent-dead-zone-bow",
        9034,
        "independent",
        {"force-exponent": 2.5, "amplifier-dead-zone": 0.2, "position-sensor-nonlinearity": 2e-4},
    ),
    _hidden("outside-hysteresis", 9041, "independent", outside={"force-hysteresis": 0.03}),
    _hidden("outside-wire-spring-quick", 9042, "independent", outside={"wire-spring": 1.5e6}, quick=True),
    _hidden("outside-supply-ripple", 9043, "independent", outside={"supply-ripple": 0.04}),
    _hidden("outside-loose-contact-quick", 9044, "independent", outside={"loose-contact": 0.04}, quick=True),
    Case(name="real-inteco-quick", campaign="twin/campaigns/inteco-diagnosis.toml", quick=True),
    Case(name="real-ce152-equilibria", campaign="twin/campaigns/ce152-equilibria.toml"),
)


def flown_log(path: Path) -> None:
    """A log of two boards: one as the nominal model has it, one whose coil's plane is 2.44 mm higher."""
    # The log's writer is the product's: it is imported here, so that the list of cases needs nothing of `twin`.
    from protocol.bus import board51_pb2 as pb
    from twin.readers.log import TwinLog

    held_m = 2.85e-3
    rigs = {"right": Rig(), "wrong": Rig(K_c=M * G / 120.364**2, gap_offset_m=2.4377e-3)}
    with TwinLog(path) as log:
        for board, rig in rigs.items():
            log.write(f"lab/{board}/parameters", rig.parameters(), message_type=pb.Parameters, log_time_ns=10**18)
            rig.hold(held_m)
            for state in rig.run(6000, lambda k: held_m if (k // 500) % 2 else 3.4e-3):
                log.write(f"lab/{board}/state", state, message_type=pb.State, log_time_ns=state.host_time_ns)
