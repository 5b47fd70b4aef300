"""`modelDescription.xml` of FMI 2.0.5 (chapter 2.2) and 3.0 (chapter 2.4): what an importer reads of the FMU."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

from twin.export.fmu.units import exponents
from twin.export.variables import Variable

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
    _head(root, fmu)
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        element = ElementTree.SubElement(listed, "ScalarVariable", _attributes(reference, variable))
        ElementTree.SubElement(element, "Real", number_attributes(variable))
    element = ElementTree.SubElement(listed, "ScalarVariable", _loop(str(len(fmu.variables))))
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
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=fmu.title,
        instantiationToken=fmu.token,
        description=fmu.text,
        generationTool=fmu.tool,
        variableNamingConvention="structured",
    )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=fmu.identifier,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        fixedInternalStepSize=repr(fmu.sample_time_s),
    )
    _head(root, fmu)
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        attributes = _attributes(reference, variable) | number_attributes(variable)
        ElementTree.SubElement(listed, "Float64", attributes)
    references = str(len(fmu.variables)), str(len(fmu.variables) + 1)
    ElementTree.SubElement(listed, "Boolean", _loop(references[0]), start="true")
    ElementTree.SubElement(
        listed,
        "Float64",
        name="time",
        valueReference=references[1],
        causality="independent",
        variability="continuous",
        unit="s",
    )
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


def _head(root: ElementTree.Element, fmu: Description) -> None:
    """Add units, log categories, and the experiment that an importer runs by default."""
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(variable.unit for variable in fmu.variables if variable.unit):
        element = ElementTree.SubElement(definitions, "Unit", name=unit)
        ElementTree.SubElement(element, "BaseUnit", {base: str(power) for base, power in exponents(unit).items()})
    if "s" not in {variable.unit for variable in fmu.variables}:
        ElementTree.SubElement(ElementTree.SubElement(definitions, "Unit", name="s"), "BaseUnit", s="1")
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="what was refused, and why")
    ElementTree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(STOP_TIME_S),
        stepSize=repr(fmu.sample_time_s),
    )


def _loop(reference: str) -> dict[str, str]:
    return {
        "name": LOOP,
        "valueReference": reference,
        "description": LOOP_TEXT,
        "causality": "parameter",
        "variability": "tunable",
    }


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
