"""`modelDescription.xml` of FMI 2.0.5 (chapter 2.2) and 3.0 (chapter 2.4): what an importer reads of the FMU."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from xml.etree import ElementTree

from twin.export.variables import Variable

SOURCES = ("model.c", "slave.c")  # and fmi2.c or fmi3.c
STOP_TIME_S = 10.0
_CAUSALITY = {"parameter": "parameter", "fixed": "parameter", "input": "input", "output": "output"}
_VARIABILITY = {"parameter": "tunable", "fixed": "fixed", "input": "continuous", "output": "continuous"}
LOOP = Variable(
    name="closed_loop",
    field="closed_loop",
    role="parameter",
    description="whether the control law drives the rig from x_ref; if not, u_c drives it",
)
# Powers of the SI base units.
_BASE: dict[str, dict[str, int]] = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^(-?\d+))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """An FMU for its importers."""

    identifier: str  # a name of C
    title: str
    text: str
    token: str
    sample_time_s: float
    variables: tuple[Variable, ...]
    tool: str


def fmi2(fmu: Description) -> str:
    """The text of modelDescription.xml for FMI 2.0."""
    root, slave = _root(fmu, "2.0", token="guid", state="FMUstate")
    files = ElementTree.SubElement(slave, "SourceFiles")
    for file in (*SOURCES, "fmi2.c"):
        ElementTree.SubElement(files, "File", name=file)
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        element = ElementTree.SubElement(listed, "ScalarVariable", _attributes(reference, variable))
        ElementTree.SubElement(element, "Real", number_attributes(variable))
    element = ElementTree.SubElement(listed, "ScalarVariable", _attributes(len(fmu.variables), LOOP))
    ElementTree.SubElement(element, "Boolean", start="true")
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [index for index, variable in enumerate(fmu.variables, 1) if variable.role == "output"]
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, part)
        for index in outputs:
            ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return text_of(root)


def fmi3(fmu: Description) -> str:
    """The text of modelDescription.xml for FMI 3.0."""
    root, slave = _root(fmu, "3.0", token="instantiationToken", state="FMUState")
    slave.set("fixedInternalStepSize", repr(fmu.sample_time_s))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        attributes = _attributes(reference, variable) | number_attributes(variable)
        ElementTree.SubElement(listed, "Float64", attributes)
    ElementTree.SubElement(listed, "Boolean", _attributes(len(fmu.variables), LOOP), start="true")
    time = {"name": "time", "valueReference": str(len(fmu.variables) + 1), "causality": "independent"}
    ElementTree.SubElement(listed, "Float64", time, variability="continuous", unit="s")
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [str(reference) for reference, variable in enumerate(fmu.variables) if variable.role == "output"]
    for part in ("Output", "InitialUnknown"):
        for output in outputs:
            ElementTree.SubElement(structure, part, valueReference=output)
    return text_of(root)


def build3(fmu: Description) -> str:
    """The text of sources/buildDescription.xml for FMI 3.0."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=fmu.identifier)
    files = ElementTree.SubElement(build, "SourceFileSet", language="C99")
    for file in (*SOURCES, "fmi3.c"):
        ElementTree.SubElement(files, "SourceFile", name=file)
    return text_of(root)


def _root(fmu: Description, version: str, *, token: str, state: str) -> tuple[ElementTree.Element, ElementTree.Element]:
    """Return (root, co-simulation) with units, log categories, and the experiment that an importer runs by default."""
    named = {"fmiVersion": version, "modelName": fmu.title, token: fmu.token, "description": fmu.text}
    root = ElementTree.Element(
        "fmiModelDescription", named, generationTool=fmu.tool, variableNamingConvention="structured"
    )
    abilities = ("canHandleVariableCommunicationStepSize", f"canGetAndSet{state}", f"canSerialize{state}")
    slave = ElementTree.SubElement(
        root, "CoSimulation", {"modelIdentifier": fmu.identifier} | dict.fromkeys(abilities, "true")
    )
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys([*(variable.unit for variable in fmu.variables if variable.unit), "s"]):
        element = ElementTree.SubElement(definitions, "Unit", name=unit)
        ElementTree.SubElement(element, "BaseUnit", {base: str(power) for base, power in exponents(unit).items()})
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="what was refused, and why")
    times = {"startTime": "0.0", "stopTime": repr(STOP_TIME_S), "stepSize": repr(fmu.sample_time_s)}
    ElementTree.SubElement(root, "DefaultExperiment", times)
    return root, slave


def _attributes(reference: int, variable: Variable) -> dict[str, str]:
    return {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": _CAUSALITY[variable.role],
        "variability": _VARIABILITY[variable.role],
    }


def number_attributes(variable: Variable) -> dict[str, str]:
    """Unit, range and start value of a variable, as both versions of FMI write them."""
    attributes = {"unit": variable.unit} if variable.unit else {}
    for key, bound in (("min", variable.low), ("max", variable.high)):
        if math.isfinite(bound):
            attributes[key] = repr(bound)
    if variable.role != "output":
        attributes["start"] = repr(float(variable.start))
    return attributes


def text_of(root: ElementTree.Element) -> str:
    """The text of an XML file."""
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def exponents(unit: str) -> dict[str, int]:
    """Return the powers of kg, m, s, A of a unit such as `N m^2/A^2` or `V/(m s)`; all behind `/` divides."""
    over, _, under = unit.partition("/")
    powers: Counter[str] = Counter()
    for part, sign in ((over, 1), (under, -1)):
        for symbol, power in _FACTOR.findall(part):
            for base, exponent in _BASE.get(symbol, {}).items():
                powers[base] += sign * exponent * int(power or 1)
    return {base: power for base, power in powers.items() if power}
