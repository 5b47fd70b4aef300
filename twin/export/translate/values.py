"""The values that the specialiser computes with: numbers that are known now, and code for those known at run time."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from protocol.errors import UsageError

Kind = Literal["float", "int", "bool"]
MODEL = "m"  # name of the record of all parameters in the written code


@dataclass(frozen=True, slots=True)
class Known:
    """A Python object: number, function, module, class, tuple of numbers."""

    value: Any


@dataclass(frozen=True, slots=True)
class Code:
    """An expression whose value is known at run time only."""

    node: ast.expr
    kind: Kind


@dataclass(frozen=True, slots=True)
class Record:
    """A named tuple of values."""

    fields: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class Several:
    """A tuple of values."""

    items: tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class Cells:
    """An array of numbers; the elements in `constants` are known, the others are read at run time."""

    node: ast.expr
    constants: Mapping[int, float]


Value: TypeAlias = Known | Code | Record | Several | Cells


class NotTranslatableError(UsageError):
    """A part of the model has no form in the language that was asked for."""


def unsupported(what: str, where: str) -> NotTranslatableError:
    """The error for a Python construct that the specialiser does not know."""
    return NotTranslatableError(
        f"{where} uses {what}, which cannot be translated", remedy="Leave out the cause that needs it, or report this"
    )


def node_of(value: Value) -> ast.expr:
    """Return the expression of a number."""
    if isinstance(value, Code):
        return value.node
    if isinstance(value, Known) and isinstance(value.value, bool | int | float):
        return ast.Constant(value.value)
    raise TypeError(f"{value} is not a number")


def kind_of(value: Value) -> Kind:
    """Return the kind of a number."""
    if isinstance(value, Code):
        return value.kind
    if isinstance(value, Known):
        return "bool" if isinstance(value.value, bool) else "int" if isinstance(value.value, int) else "float"
    raise TypeError(f"{value} is not a number")


def common(*kinds: Kind) -> Kind:
    """Return the kind that holds values of all these kinds."""
    return "float" if "float" in kinds else "int" if "int" in kinds else "bool"


def name(text: str) -> ast.Name:
    """Return the expression of a variable."""
    return ast.Name(text, ast.Load())


def parameter(field: str) -> Code:
    """Return the expression of a number in the record of parameters."""
    return Code(ast.Attribute(name(MODEL), field, ast.Load()), "float")


def is_parameter(node: ast.expr) -> bool:
    """Return whether an expression is a number of the record of parameters, which no function changes."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Constant):
            return False
        node = node.value
    return isinstance(node, ast.Name) and node.id == MODEL
