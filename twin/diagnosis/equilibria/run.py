"""The diagnosis of a campaign of points of rest alone: when it is asked for, and what it reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from protocol.campaign import Campaign
from twin.diagnosis.equilibria.diagnosis import StaticDiagnosis, diagnose_points
from twin.diagnosis.judge.reference_model import check_plant
from twin.model.parameters import Model
from twin.readers.campaign import read_campaign


def is_static(campaign: Campaign) -> bool:
    """Return whether every recording for fitting is of kind `equilibria`."""
    kinds = {recording.kind for recording in campaign.recordings if recording.use == "fit"}
    return kinds == {"equilibria"}


def diagnose_static(
    campaign: Campaign, *, data: Path | None, model: Model | None, say: Callable[[str], None]
) -> StaticDiagnosis:
    """Diagnose points of rest.

    Raises:
        DataError: recordings that cannot be used, or a model of another plant.
    """
    if model is not None:
        check_plant(model, campaign.plant)
    records = read_campaign(campaign, data=data)
    judges = read_campaign(campaign, use="judge", data=data)
    return diagnose_points(campaign, records, judges, model=model, say=say)
