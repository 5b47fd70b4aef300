"""A force law that cannot explain the flights: its error must not pass for noise of the sensors."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.emulator.flash import INPUT, POSITION
from gateway.emulator.rig import CE152
from protocol.campaign import parse
from protocol.wire.messages import Mode, Shape
from tests.twin.identify.emulated_campaign import Lab
from twin.identify.pipeline import identify_records
from twin.identify.record import Record

# x_max = travel is what a user knows; the coil of this rig is higher.
CAMPAIGN = parse(
    f'[plant]\nname = "ce152"\nmass_kg = {CE152.mass_kg}\ntravel_m = {CE152.travel_m}\n'
    '[[recording]]\nfile = "in memory"\nkind = "free"\nuse = "fit"\n',
    where="campaign.toml",
    folder=Path(),
)


def flights(seed: int) -> list[Record]:
    """The ball between the stops in open loop, then wide steps of the reference."""
    lab = Lab(CE152, seed=seed)
    lift = INPUT.to_count(CE152.equilibrium_input_v(0.0))
    lab.ask("SET_MODE", mode=int(Mode.OPEN_LOOP))
    lab.excite(
        Shape.PRBS,
        on_reference=False,
        amplitude=round(0.55 * lift),
        offset=round(0.65 * lift),
        period=20,
        seed=seed + 1,
    )
    bounces = lab.record("bounces", "prbs", 1600)
    lab.ask("SET_MODE", mode=int(Mode.IDLE))
    lab.run(100)
    lab.fly()
    lab.run(200)
    at, span = POSITION.to_count(2.85e-3), POSITION.span(1.2e-3)
    lab.excite(Shape.RECTANGLE, on_reference=True, amplitude=span, offset=at, period=300, seed=1)
    return [bounces, lab.record("wide", "closed-loop", 1600)]


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_the_error_of_the_law_is_not_called_noise_of_the_sensor(seed: int) -> None:
    found = identify_records(CAMPAIGN, flights(seed))

    noise = found.model.noise
    # 3200 samples know a standard deviation to 1.3 %; what the law lacks may add to it, but not make it another size.
    assert noise.sigma_x_m == pytest.approx(CE152.position_noise_m, rel=0.3)
    assert noise.process_a_m_s2 > 1.0, "what the law lacks is acceleration"
