"""`modelDescription.xml` of FMI 2.0.5 (chapter 2.2): what an importer reads of the FMU."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

from twin.export.fmu.units import exponents
from twin.export.variables import Variable

Version = str  # "2.0" or "3.0"
SOURCES = ("model.c", "slave.c")  # and fmi2.c or fmi3.c
STOP_TIME_S = 10.0
_CAUSALITY = {"parameter": "parameter", "fixed": "parameter", "input": "input", "output": "output"}
_VARIABILITY = {"parameter": "tunable", "fixed": "fixed", "input": "continuous", "output": "continuous"}
LOOP = "closed_loop"
LOOP_TEXT = "whether the control law drives the rig from x_ref; if not, u_c drives it"


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
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=fmu.title,
        guid=fmu.token,
        description=fmu.text,
        generationTool=fmu.tool,
        variableNamingConvention="structured",
    )
    slave = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=fmu.identifier,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    files = ElementTree.SubElement(slave, "SourceFiles")
    for file in (*SOURCES, "fmi2.c"):
        ElementTree.SubElement(files, "File", name=file)
    add_units(root, fmu.variables)
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="what was refused, and why")
    add_experiment(root, fmu)
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        _variable(listed, reference, variable)
    element = ElementTree.SubElement(
        listed,
        "ScalarVariable",
        name=LOOP,
        valueReference=str(len(fmu.variables)),
        description=LOOP_TEXT,
        causality="parameter",
        variability="tunable",
    )
    ElementTree.SubElement(element, "Boolean", start="true")
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [index for index, variable in enumerate(fmu.variables, 1) if variable.role == "output"]
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, part)
        for index in outputs:
            ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return text_of(root)


def _variable(listed: ElementTree.Element, reference: int, variable: Variable) -> None:
    element = ElementTree.SubElement(
        listed,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        description=variable.description,
        causality=_CAUSALITY[variable.role],
        variability=_VARIABILITY[variable.role],
    )
    ElementTree.SubElement(element, "Real", number_attributes(variable))


def number_attributes(variable: Variable) -> dict[str, str]:
    """Unit, range and start value of a variable, as both versions of FMI write them."""
    attributes = {"unit": variable.unit} if variable.unit else {}
    for key, bound in (("min", variable.low), ("max", variable.high)):
        if math.isfinite(bound):
            attributes[key] = repr(bound)
    if variable.role != "output":
        attributes["start"] = repr(float(variable.start))
    return attributes


def add_units(root: ElementTree.Element, variables: tuple[Variable, ...]) -> None:
    """Add the units of all variables."""
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(variable.unit for variable in variables if variable.unit):
        element = ElementTree.SubElement(definitions, "Unit", name=unit)
        ElementTree.SubElement(element, "BaseUnit", {base: str(power) for base, power in exponents(unit).items()})


def add_experiment(root: ElementTree.Element, fmu: Description) -> None:
    """Add the experiment that an importer runs by default."""
    ElementTree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(STOP_TIME_S),
        stepSize=repr(fmu.sample_time_s),
    )


def text_of(root: ElementTree.Element) -> str:
    """The text of an XML file."""
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
