"""An importer of FMUs: runs one step by step through FMPy, as another tool does."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from twin.estimation.record import FloatArray

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("gcc", "cc", "clang"))), reason="no C compiler is installed: apt-get install gcc"
)


@dataclass(frozen=True, slots=True)
class Instance:
    """A running FMU of either version; variables by name."""

    slave: Any
    references: Mapping[str, int]
    log: list[str]  # its log

    def set(self, name: str, value: float) -> None:
        flag = self.slave.setBoolean
        number = self.slave.setReal if isinstance(self.slave, FMU2Slave) else self.slave.setFloat64
        (flag if name == "closed_loop" else number)([self.references[name]], [value])

    def get(self, *names: str) -> list[float]:
        number = self.slave.getReal if isinstance(self.slave, FMU2Slave) else self.slave.getFloat64
        values: list[float] = number([self.references[name] for name in names])
        return values

    def begin(self, settings: Mapping[str, float]) -> None:
        """Initialise a new instance, or one that has been reset."""
        if isinstance(self.slave, FMU2Slave):
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        for name, value in settings.items():
            self.set(name, value)
        self.slave.exitInitializationMode()

    def restart(self, settings: Mapping[str, float]) -> None:
        self.slave.reset()
        self.begin(settings)

    def step(self, time_s: float, duration_s: float) -> None:
        self.slave.doStep(time_s, duration_s)


@contextmanager
def running(path: Path, settings: Mapping[str, float] | None = None) -> Iterator[Instance]:
    """An initialised instance of an FMU, unpacked beside it."""
    description = fmpy.read_model_description(str(path))
    unpacked = fmpy.extract(str(path), unzipdir=str(path.with_suffix("")))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    kind = FMU2Slave if description.fmiVersion == "2.0" else FMU3Slave
    log: list[str] = []
    slave = kind(
        guid=description.guid, unzipDirectory=unpacked, modelIdentifier=description.coSimulation.modelIdentifier
    )
    instance = Instance(slave, references, log)
    if kind is FMU2Slave:
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda env, name, status, category, text: log.append(text.decode()))
        slave.instantiate(callbacks=callbacks)
    else:
        slave.instantiate(logMessage=lambda env, status, category, text: log.append(text.decode()))
    instance.begin(settings or {})
    yield instance
    slave.terminate()
    slave.freeInstance()


def flown(path: Path, drive: FloatArray, outputs: tuple[str, ...], *, closed_loop: bool, T_s: float) -> FloatArray:
    """`outputs` after each tick under references or inputs, shape (n, outputs)."""
    flight = np.empty((len(drive), len(outputs)))
    with running(path, {"closed_loop": closed_loop}) as rig:
        for k, value in enumerate(drive):
            rig.set("x_ref" if closed_loop else "u_c", float(value))
            rig.step(k * T_s, T_s)
            flight[k] = rig.get(*outputs)
    return flight
