"""Units that are not SI, by the name of a column and by the size of its values."""

from __future__ import annotations

import math

import pytest
from pydantic.fields import FieldInfo

from protocol.campaign import CHANNELS, UNITS, Plant
from protocol.checked import bounds, keys_of
from protocol.units import MAX_PLAUSIBLE, NOT_MEASURED, SCALES, scale_of_size, unit_of_name


@pytest.mark.parametrize(
    ("column", "channel", "unit"),
    [
        ("x_mm", "x", ("mm", 1e-3)),
        ("Position [mm]", "x", ("mm", 1e-3)),
        ("gap (\u00b5m)", "x", ("\u00b5m", 1e-6)),
        ("run.ref_um", "x_ref", ("um", 1e-6)),
        ("mm", "x", ("mm", 1e-3)),
        ("t_ms", "t", ("ms", 1e-3)),
        ("i_mA", "i_c", ("mA", 1e-3)),
        ("coil/mV", "u_c", ("mV", 1e-3)),
        ("t_s", "t", None),
        ("x_m", "x", None),
        ("i1_A", "i_c", None),
        ("comm", "x", None),
        ("programs", "t", None),
        ("x_ms", "x", None),
        ("", "x", None),
    ],
)
def test_a_name_tells_its_unit_at_its_end(column: str, channel: str, unit: tuple[str, float] | None) -> None:
    assert unit_of_name(column, channel) == unit


def test_every_channel_has_its_ranges() -> None:
    assert set(SCALES) == set(MAX_PLAUSIBLE) == set(NOT_MEASURED) == set(CHANNELS) == set(UNITS)


@pytest.mark.parametrize(
    ("largest", "scale"), [(0.0057, None), (0.5, None), (5.7, 1e-3), (5700.0, 1e-6), (5.7e6, 1e-9)]
)
def test_a_size_suggests_the_power_of_1000_that_makes_it_plausible(largest: float, scale: float | None) -> None:
    assert scale_of_size(largest, "x") == scale


def test_the_masses_are_those_of_the_steel_balls_that_the_message_names() -> None:
    mass_kg = keys_of(Plant)["mass_kg"]

    diameters_mm = [1e3 * (6.0 * mass / (math.pi * 7850.0)) ** (1.0 / 3.0) for mass in bounds(mass_kg) if mass]

    named = f"as steel balls of {diameters_mm[0]:.1f} to {diameters_mm[1]:.0f} mm have"
    assert named in (FieldInfo.from_annotation(mass_kg).description or "")
