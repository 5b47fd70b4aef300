"""The model file of an emulated rig with its effects: what a perfect diagnosis of it would write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.emulator.plant.constants import CE152, PlantConstants
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model, model_from_dict


def entry(value: float, unit: str) -> dict[str, Any]:
    return {
        "value": value,
        "unit": unit,
        "std": 0.01 * abs(value),
        "ci95": [0.98 * value, 1.02 * value],
        "verdict": "identified",
        "method": "told by the emulator",
        "equation": "",
    }


def cause(name: str, strength: float) -> dict[str, Any]:
    """The JSON of a cause, its other parameters as the emulator fixes them: 30 s of heating, 7 Hz of shaking."""
    first, *rest = BY_NAME[name].parameters
    parameters = {first.name: entry(strength, first.unit)}
    return {"name": name, "parameters": parameters | {item.name: entry(item.neutral, item.unit) for item in rest}}


def true_model(rig: PlantConstants = CE152, effects: Mapping[str, float] | None = None) -> Model:
    """A model that knows rig and effects; without effects the paper's model with x_max at the coil's plane."""
    data = {
        "plant": {
            "name": "emulated",
            "mass_kg": rig.mass_kg,
            "travel_m": rig.travel_m,
            "x_max_m": rig.travel_m + rig.coil_plane_above_stop_m,
            "gravity_m_s2": rig.gravity_m_s2,
        },
        "parameters": {
            "K_A": entry(rig.amplifier_gain_a_v, "A/V"),
            "T_A": entry(rig.amplifier_time_constant_s, "s"),
            "K_c": entry(rig.force_constant_n_m2_a2, "N m^2/A^2"),
            "b": entry(rig.drag_n_s_m, "N s/m"),
        },
        "causes": [cause(name, strength) for name, strength in (effects or {}).items()],
        "noise": {
            "sigma_x_m": rig.position_noise_m,
            "sigma_i_c_a": rig.current_noise_a,
            "process_a_m_s2": 0.02,
            "process_i_c_a": 1e-4,
        },
        "provenance": {},
    }
    return model_from_dict(data, where="the emulator")
