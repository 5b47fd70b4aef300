"""The model and its critic: the paper's equations in step with a rig, and where they part.

    from twin import Campaign, diagnose, identify, predict

    campaign = Campaign.load("runs/monday")
    model = identify(campaign).model
    found = diagnose(campaign, model=model, quick=True)
    print(found.sentence)
    found.save("diagnosis")                         # diagnosis.json, report.html, extended_model.json
    ahead = predict(found.extended, "runs/monday/flight.csv", horizon_samples=10)
    print(ahead.rmse_m, ahead.x_hat_m.shape)

Quantities are in SI units.  `import twin` is quick: a name is imported when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from protocol.campaign import Campaign
    from twin.api.exports import export_model
    from twin.api.functions import bode, design, diagnose, identify, predict, validate
    from twin.api.results import Designed, Diagnosed, FrequencyResponses, Identified, Predicted, Validated
    from twin.export.formats import Exported
    from twin.model.parameters import Model

__all__ = [
    "Campaign",
    "Designed",
    "Diagnosed",
    "Exported",
    "FrequencyResponses",
    "Identified",
    "Model",
    "Predicted",
    "Validated",
    "bode",
    "design",
    "diagnose",
    "export_model",
    "identify",
    "predict",
    "validate",
]

_ELSEWHERE = {
    "Campaign": "protocol.campaign",
    "Exported": "twin.export.formats",
    "Model": "twin.model.parameters",
    "export_model": "twin.api.exports",
}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _ELSEWHERE.get(name, "twin.api.functions")  # they return the results, and import their classes
    return getattr(importlib.import_module(module), name)


def __dir__() -> list[str]:
    return __all__
