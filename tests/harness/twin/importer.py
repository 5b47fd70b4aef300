"""An importer of FMUs: runs one step by step through FMPy, as another tool does."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from twin.estimation.record import FloatArray

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("gcc", "cc", "clang"))), reason="no C compiler is installed: apt-get install gcc"
)


@contextmanager
def running(path: Path, folder: Path, settings: Mapping[str, float] | None = None) -> Iterator[Any]:
    """An initialised instance, and beside it the references of its variables: (instance, references)."""
    told = fmpy.read_model_description(str(path))
    unpacked = fmpy.extract(str(path), unzipdir=str(folder))
    references = {variable.name: variable.valueReference for variable in told.modelVariables}
    slave = FMU2Slave(guid=told.guid, unzipDirectory=unpacked, modelIdentifier=told.coSimulation.modelIdentifier)
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    for name, value in (settings or {}).items():
        set_ = slave.setBoolean if name == "closed_loop" else slave.setReal
        set_([references[name]], [value])
    slave.exitInitializationMode()
    yield slave, references
    slave.terminate()
    slave.freeInstance()


def flown(
    path: Path, folder: Path, drive: FloatArray, outputs: tuple[str, ...], *, closed_loop: bool, T_s: float
) -> FloatArray:
    """`outputs` after each tick under references or inputs, shape (n, outputs)."""
    flight = np.empty((len(drive), len(outputs)))
    with running(path, folder, {"closed_loop": closed_loop}) as (slave, references):
        wanted = [references[name] for name in outputs]
        for k, value in enumerate(drive):
            slave.setReal([references["x_ref" if closed_loop else "u_c"]], [value])
            slave.doStep(k * T_s, T_s)
            flight[k] = slave.getReal(wanted)
    return flight
