"""Constant folding: what is known is computed at translation, and terms and factors without effect are left out.

Rule: 0 times a number is 0, and a number over infinity is 0.  That holds for finite numbers, as all states of the rig
      are; the sign of a zero is not kept.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

from twin.export.translate.values import Code, Kind, Known, Value, common, kind_of, name, node_of

_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_BUILT_IN: dict[str, Callable[..., Any]] = {"min": min, "max": max, "abs": abs, "float": float, "int": int}


def is_number(value: Value, *numbers: float) -> bool:
    """Return whether a value is known and one of these numbers."""
    return isinstance(value, Known) and isinstance(value.value, int | float) and value.value in numbers


def arithmetic(op: ast.operator, left: Value, right: Value) -> Value:
    """Return left op right."""
    if isinstance(left, Known) and isinstance(right, Known):
        return Known(_ARITHMETIC[type(op)](left.value, right.value))
    kind = common(kind_of(left), kind_of(right))
    if kind == "float" or type(op) in (ast.Div, ast.Pow):
        kind = "float"
        short = _shortened(op, left, right)
        # A short form of another kind would change the type of a variable.
        if short is not None and kind_of(short) == kind:
            return short
    return Code(ast.BinOp(node_of(left), op, node_of(right)), kind)


def _shortened(op: ast.operator, left: Value, right: Value) -> Value | None:
    """Return left op right where one side has no effect or alone determines the result; None elsewhere."""
    match op:
        case ast.Add():
            return right if is_number(left, 0.0) else left if is_number(right, 0.0) else None
        case ast.Sub():
            return left if is_number(right, 0.0) else negative(right) if is_number(left, 0.0) else None
        case ast.Mult() if is_number(left, 0.0) or is_number(right, 0.0):
            return Known(0.0)
        case ast.Mult():
            return right if is_number(left, 1.0) else left if is_number(right, 1.0) else None
        case ast.Div() if is_number(left, 0.0) or is_number(right, math.inf, -math.inf):
            return Known(0.0)
        case ast.Div() | ast.Pow():
            return left if is_number(right, 1.0) else None
        case _:
            return None


def negative(value: Value) -> Value:
    """Return -value."""
    if isinstance(value, Known):
        return Known(-value.value)
    return Code(ast.UnaryOp(ast.USub(), node_of(value)), kind_of(value))


def opposite(value: Value) -> Value:
    """Return not value."""
    return Known(not value.value) if isinstance(value, Known) else Code(ast.UnaryOp(ast.Not(), node_of(value)), "bool")


def comparison(op: ast.cmpop, left: Value, right: Value) -> Value:
    """Return left op right, a truth value."""
    if isinstance(left, Known) and isinstance(right, Known):
        return Known(_COMPARISONS[type(op)](left.value, right.value))
    return Code(ast.Compare(node_of(left), [op], [node_of(right)]), "bool")


def logic(op: ast.boolop, values: list[Value]) -> Value:
    """Return `values[0] op values[1] op ..`: a known value decides, or is left out."""
    decides = isinstance(op, ast.Or)
    left: list[Value] = []
    for value in values:
        if not isinstance(value, Known):
            left.append(value)
        elif bool(value.value) == decides:
            # Not the value alone: what stands before it may call a function.
            return Known(decides) if not left else Code(ast.BoolOp(op, [*map(node_of, left), node_of(value)]), "bool")
    if not left:
        return Known(not decides)
    return left[0] if len(left) == 1 else Code(ast.BoolOp(op, [node_of(value) for value in left]), "bool")


def choice(test: Value, yes: Callable[[], Value], no: Callable[[], Value]) -> Value:
    """Return `yes() if test else no()`."""
    if isinstance(test, Known):
        return yes() if test.value else no()
    first, second = yes(), no()
    return Code(ast.IfExp(node_of(test), node_of(first), node_of(second)), common(kind_of(first), kind_of(second)))


def function(known: Callable[..., Any], values: list[Value]) -> Value:
    """Return a call of a built-in function or one of `math`; its result if all values are known."""
    if all(isinstance(value, Known) for value in values):
        return Known(known(*(value.value for value in values if isinstance(value, Known))))
    if known in (min, max):
        # An infinite bound is none: so the limits of absent causes vanish.
        no_bound = math.inf if known is min else -math.inf
        values = [value for value in values if not is_number(value, no_bound)]
        if len(values) == 1:
            return values[0]
    if known is float and kind_of(values[0]) == "float":
        return values[0]
    kind: Kind = "float"
    if known in (int, math.floor, math.ceil):
        kind = "int"
        if kind_of(values[0]) == "int":
            return values[0]
    elif known in (math.isinf, math.isfinite):
        kind = "bool"
    elif known in (min, max, abs):
        kind = common(*map(kind_of, values))
    called = known.__name__ if known.__name__ in _BUILT_IN else f"math.{known.__name__}"
    node: ast.expr = name(called)
    if "." in called:
        node = ast.Attribute(name("math"), known.__name__, ast.Load())
    return Code(ast.Call(node, [node_of(value) for value in values], []), kind)
