"""Checks that every public name is listed and documented, and says its units and shapes.

A name is public where `__all__` of `twin`, `gateway.client` or `gateway.testing` has it.  Each has a docstring;
for each parameter, field and property that is a number or an array: its unit, as the end of its name or beside it; for
each array: its shape.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

LIBRARIES = ("twin", "gateway.client", "gateway.testing")
ELSEWHERE = {"twin": {"Campaign", "Model"}}  # whose fields are those of a file: its own page says their units
NUMBER = re.compile(r"\bfloat\b|Array\b|NDArray")
ARRAY = re.compile(r"Array\b|NDArray")
IN_NAME = re.compile(r"_(m|s|a|v|hz|m_s|lsb)$")
UNIT = re.compile(
    r"(?<![\w/])(m|s|A|V|Hz|N|bit/s|V/A|V/m|1/A\^2|1/V\^2|times faster|0 to 1|filter steps|in z|their units|"
    r"control periods|bits of|nothing is continuous|samples missing|\"idle\")(?![\w/])"
)
SHAPE = re.compile(r"shape \(\w+,[^)]*\)|\bFour\b")


@dataclass
class Bad:
    """A result."""

    height: float  # of the ball
    trace: npt.NDArray[np.float64]  # m
    width_m: float

    def speed(self, after: float) -> npt.NDArray[np.float64]:
        return np.array([after])


def public() -> list[tuple[str, str]]:
    return [(library, name) for library in LIBRARIES for name in importlib.import_module(library).__all__]


def problems(name: str, thing: Any, *, fields: bool = True) -> Iterator[str]:
    """Yield each thing that is missing of one public name."""
    if not inspect.getdoc(thing):
        yield f"{name}: no docstring"
    if inspect.isclass(thing):
        if is_dataclass(thing) and fields:
            yield from _fields(name, thing)
        for key, member in vars(thing).items():
            if key.startswith("_") and key not in ("__init__", "__call__"):
                continue
            class_doc = inspect.getdoc(thing) or "" if key == "__init__" else ""
            if isinstance(member, property):
                member = member.fget
            if isinstance(member, classmethod | staticmethod):
                member = member.__func__
            if inspect.isfunction(member) and not (key == "__init__" and is_dataclass(thing)):
                yield from _function(f"{name}.{key}", member, class_doc)
    elif inspect.isroutine(thing):
        yield from _function(name, thing, "")
        if "Args:" not in (inspect.getdoc(thing) or "") or "Returns:" not in (inspect.getdoc(thing) or ""):
            yield f"{name}: no Args or no Returns"


def _function(name: str, function: Callable[..., Any], class_doc: str) -> Iterator[str]:
    doc = class_doc or inspect.getdoc(function) or ""
    if not doc:
        yield f"{name}: no docstring"
    for key, parameter in inspect.signature(function).parameters.items():
        entry = re.search(rf"^\s+{key}: (.*(?:\n {{8,}}.*)*)", doc, re.MULTILINE)
        if "Args:" in doc and key not in ("self", "cls") and entry is None:
            yield f"{name}: {key} is not among Args"
        yield from _quantity(f"{name}: {key}", str(parameter.annotation), entry.group(1) if entry else doc, key)
    returned = str(inspect.signature(function).return_annotation)
    if ARRAY.search(returned) and not SHAPE.search(doc):
        yield f"{name}: returns an array of no shape"


def _fields(name: str, kind: type) -> Iterator[str]:
    source = inspect.getsource(kind)
    for key, annotation in kind.__annotations__.items():
        line = re.search(rf"^    {key}: .*$", source, re.MULTILINE)
        comment = line.group().partition("#")[2] if line else ""
        yield from _quantity(f"{name}.{key}", str(annotation), comment, key)


def _quantity(name: str, annotation: str, description: str, key: str) -> Iterator[str]:
    if NUMBER.search(annotation) and not (IN_NAME.search(key) or UNIT.search(description)):
        yield f"{name}: no unit"
    if ARRAY.search(annotation) and not SHAPE.search(description):
        yield f"{name}: no shape"


@pytest.mark.parametrize(("library", "name"), public())
def test_a_public_name_says_what_it_is_in_which_unit_and_shape(library: str, name: str) -> None:
    thing = getattr(importlib.import_module(library), name)

    assert list(problems(name, thing, fields=name not in ELSEWHERE.get(library, ()))) == []


@pytest.mark.parametrize("library", LIBRARIES)
def test_every_listed_name_is_there_and_no_other(library: str) -> None:
    module = importlib.import_module(library)

    assert sorted(module.__all__) == list(module.__all__)
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError):
        module.no_such_name  # noqa: B018


def test_what_lacks_docstring_unit_or_shape_is_found() -> None:
    def nameless(height: float) -> float:
        return height

    assert list(problems("Bad", Bad)) == [
        "Bad.height: no unit",
        "Bad.trace: no shape",
        "Bad.speed: no docstring",
        "Bad.speed: after: no unit",
        "Bad.speed: returns an array of no shape",
    ]
    assert "nameless: no docstring" in list(problems("nameless", nameless))
    assert "nameless: height: no unit" in list(problems("nameless", nameless))
