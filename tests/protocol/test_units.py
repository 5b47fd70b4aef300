"""Units that are not SI, by the name of a column and by the size of its values."""

from __future__ import annotations

import math

import pytest
from pydantic.fields import FieldInfo

from protocol.campaign import CHANNELS, Plant
from protocol.checked import bounds, keys_of
from protocol.errors import UsageError
from protocol.units import MAX_PLAUSIBLE, NOT_MEASURED, SCALES, UNITS, quantity, scale_of_size, unit_of_name


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


@pytest.mark.parametrize(
    ("text", "channel", "value"),
    [
        ("0.003", "x_ref", 3e-3),
        ("3mm", "x_ref", 3e-3),
        ("-2.5 mm", "x", -2.5e-3),
        ("3e3\u00b5m", "x", 3e-3),
        ("800mV", "u_c", 0.8),
        ("2V", "u_c", 2.0),
        ("20mA", "i_c", 0.02),
        ("2ms", "t", 2e-3),
    ],
)
def test_a_quantity_is_in_si_or_bears_its_unit(text: str, channel: str, value: float) -> None:
    assert quantity(text, channel) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "channel", "expected"),
    [
        ("3", "x_ref", "3 m is more than any such rig has. You may mean 0.003 (3 mm)."),
        ("-1500", "u_c", "-1500 V is more than any such rig has. You may mean -1.5 (-1500 mV)."),
        ("2", "t", "2 s is more than any such rig has. You may mean 0.002 (2 ms)."),
        ("3m", "x", "You may mean 0.003 (3 mm)"),
        ("nan", "x", "'nan' is not a finite number"),
        ("1e999", "x", "'1e999' is not a finite number"),
        ("3mV", "x", "'3mV' is not a number. Give it in m, or with its unit: 3mm."),
        ("", "i_c", "'' is not a number"),
    ],
)
def test_a_quantity_that_is_none_is_asked_back(text: str, channel: str, expected: str) -> None:
    with pytest.raises(UsageError) as error:
        quantity(text, channel)

    assert expected in str(error.value)


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
