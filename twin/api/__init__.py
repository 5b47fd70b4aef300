"""The public functions of the twin and their results; `twin.__all__` lists them."""

from twin.api.functions import design, diagnose, identify, predict, validate
from twin.api.results import Designed, Diagnosed, Identified, Predicted, Validated

__all__ = [
    "Designed",
    "Diagnosed",
    "Identified",
    "Predicted",
    "Validated",
    "design",
    "diagnose",
    "identify",
    "predict",
    "validate",
]
