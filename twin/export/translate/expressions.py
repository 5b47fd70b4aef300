"""The values of expressions under the specialiser."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, Protocol

from twin.export.translate import fold
from twin.export.translate.values import Cells, Code, Known, Record, Several, Value, name, node_of, unsupported

_OF_PYTHON = (min, max, abs, float, int)


class Calls(Protocol):
    """The program that a body belongs to."""

    tables: dict[str, tuple[float, ...]]

    def call(self, function: Callable[..., Any], arguments: Sequence[Value], caller: Expressions) -> Value | None:
        """Return the value of a call."""


class Expressions:
    """Expressions of one function, in which `local` names have values."""

    def __init__(self, program: Calls, outside: Mapping[str, Any], local: dict[str, Value], *, where: str) -> None:
        self.program, self.outside, self.local, self.where = program, outside, local, where

    def emit(self, statement: ast.stmt) -> None:
        """Write a statement."""
        raise NotImplementedError

    def keep_results(self, call: ast.expr, called: str) -> str:
        """Write a call with several results; returns the variable that holds them."""
        raise NotImplementedError

    def value(self, node: ast.expr) -> Value:
        """Return the value of an expression.  Raises NotTranslatableError."""
        value = self.value_or_none(node)
        if value is None:
            raise unsupported(f"the result of `{ast.unparse(node)}`, which has none,", self.where)
        return value

    def value_or_none(self, node: ast.expr) -> Value | None:
        """Return the value of an expression; None: of a call without a result."""
        match node:
            case ast.Constant(value=value):
                return Known(value)
            case ast.Name(id=key):
                return self.local[key] if key in self.local else Known(self._global(key))
            case ast.Attribute(value=inner, attr=key):
                return self._attribute(self.value(inner), key)
            case ast.Subscript(value=inner, slice=index):
                return self._element(inner, self.value(index))
            case ast.Tuple(elts=items):
                return Several(tuple(self.value(item) for item in items))
            case ast.BinOp(left=left, op=op, right=right):
                return fold.arithmetic(op, self.value(left), self.value(right))
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return fold.negative(self.value(inner))
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return fold.opposite(self.value(inner))
            case ast.Compare(left=left, ops=ops, comparators=others):
                values = [self.value(value) for value in (left, *others)]
                pairs = [fold.comparison(op, a, b) for op, a, b in zip(ops, values, values[1:], strict=False)]
                return fold.logic(ast.And(), pairs)
            case ast.BoolOp(op=op, values=parts):
                return fold.logic(op, [self.value(part) for part in parts])
            case ast.IfExp(test=test, body=yes, orelse=no):
                return fold.choice(self.value(test), lambda: self.value(yes), lambda: self.value(no))
            case ast.Call():
                return self._call(node)
            case _:
                raise unsupported(f"`{ast.unparse(node)}`", self.where)

    def _global(self, key: str) -> Any:
        if key in self.outside:
            return self.outside[key]
        built_in = {function.__name__: function for function in (*_OF_PYTHON, len)}
        if key not in built_in:
            raise unsupported(f"the name {key}", self.where)
        return built_in[key]

    def _attribute(self, value: Value, key: str) -> Value:
        if isinstance(value, Record):
            return value.fields[key]
        if isinstance(value, Known) and isinstance(value.value, ModuleType):
            return Known(getattr(value.value, key))
        raise unsupported(f"the attribute {key}", self.where)

    def _element(self, node: ast.expr, index: Value) -> Value:
        value = self.value(node)
        if isinstance(value, Cells):
            if isinstance(index, Known) and index.value in value.constants:
                return Known(value.constants[index.value])
            return Code(ast.Subscript(value.node, node_of(index), ast.Load()), "float")
        if isinstance(index, Known) and isinstance(value, Several):
            items: tuple[Value, ...] = value.items
            return items[int(index.value)]
        if isinstance(value, Known) and isinstance(value.value, tuple) and isinstance(node, ast.Name):
            if isinstance(index, Known):
                return Known(value.value[index.value])
            # The index is not known now, so the tuple becomes a table of the program.
            self.program.tables[node.id] = value.value
            return Code(ast.Subscript(name(node.id), node_of(index), ast.Load()), "float")
        raise unsupported(f"`{ast.unparse(node)}[..]`", self.where)

    def _call(self, node: ast.Call) -> Value | None:
        called = self.value(node.func)
        if not isinstance(called, Known) or node.keywords:
            raise unsupported(f"`{ast.unparse(node)}`", self.where)
        function = called.value
        if isinstance(function, type) and issubclass(function, tuple):  # Base(*base) of the kernels
            (packed,) = node.args
            return self.value(packed.value if isinstance(packed, ast.Starred) else packed)
        values = [self.value(argument) for argument in node.args]
        if function is len:
            return Known(len(values[0].value if isinstance(values[0], Known) else ()))
        if function in _OF_PYTHON or getattr(math, getattr(function, "__name__", ""), None) is function:
            return fold.function(function, values)
        return self.program.call(function, values, self)
