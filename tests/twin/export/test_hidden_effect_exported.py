"""A hidden effect becomes an FMU that predicts as well as the product does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import twin
from protocol.campaign import Campaign
from tests.harness.diagnose.hidden_campaign import make_campaign
from tests.harness.twin.importer import needs_compiler, running
from twin.control_design.design import Specification, design
from twin.estimation.ekf.filter import filtered
from twin.estimation.record import FloatArray, Record
from twin.evidence.gather import gather
from twin.export import controller
from twin.export.fmu.pack import fmu
from twin.model.extended import I_C, V, X, current_reading, position_reading
from twin.model.extension import base, vector
from twin.model.parameters import Model
from twin.prediction import predict
from twin.readers.campaign import read_campaign
from twin.validation.extended import system_of
from twin.validation.source import source_of

AHEAD = 10
EVERY = 7  # of the samples that are predicted


def fmu_ahead(path: Path, model: Model, record: Record, rows: NDArray[np.intp]) -> FloatArray:
    """The readings of x at these rows, each from the estimate AHEAD samples earlier with the recorded u_c, m."""
    recording = source_of(replace(record, captures=()), model).acting
    samples = gather([recording], model.plant, (0.0, model.plant.travel_m)).samples
    state = filtered(system_of(model, record), samples, state=True).state
    p, c = base(model), vector(model.causes)
    x_hat = np.empty(len(rows))
    with running(path) as rig:
        for index, row in enumerate(rows):
            y = state[row - AHEAD]
            rig.restart(
                {
                    "closed_loop": False,
                    "start.i": float(current_reading(c, y[I_C])),
                    "start.x": float(position_reading(p, c, y[X], y[I_C])),
                    "start.v": float(y[V]),
                }
            )
            for k in range(AHEAD):
                rig.set("u_c", float(samples.u[row - AHEAD + k]))
                rig.step(k * record.interval_s, record.interval_s)
            (x_hat[index],) = rig.get("y_x")
    return x_hat


@pytest.mark.slow
@needs_compiler
def test_the_fmu_predicts_the_judge_recordings_as_predict_does(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    make_campaign(folder, effects={"quadratic-drag": 4.0}, seed=8675309, plant="emulator", quick=True)
    diagnosed = twin.diagnose(folder, quick=True)
    model = diagnosed.extended
    assert [cause.name for cause in model.causes] == ["quadratic-drag"]
    path = tmp_path / "rig.fmu"
    path.write_bytes(fmu(model, controller.of_design(design(model, Specification()), u_max_v=5.0).numbers).content)

    compared = 0
    for record in read_campaign(Campaign.load(folder), use="judge"):
        if record.kind != "closed-loop":
            continue
        prediction = predict(model, record, AHEAD)
        rows = np.flatnonzero(np.isin(record.t, prediction.t))[::EVERY]
        exported = fmu_ahead(path, model, record, rows)
        product = prediction.x_hat[::EVERY]
        measured = record.x[rows]
        compared += len(rows)

        errors = [float(np.sqrt(np.mean((x_hat - measured) ** 2))) for x_hat in (exported, product)]
        assert errors[0] == pytest.approx(errors[1], rel=0.01)

    assert compared > 200
