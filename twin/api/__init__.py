"""The twin from Python; what is public is listed in `twin.__all__`."""

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
