"""The statements and expressions of a program of the specialiser, as the languages write them alike.

Rule: an operand is in brackets unless it is a name, a number or a call, or a product or quotient in a sum.  Other
      precedences differ between the languages.
"""

from __future__ import annotations

import ast
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import Kind, unsupported

_LEVELS: Mapping[type[ast.operator], int] = {ast.Add: 1, ast.Sub: 1, ast.Mult: 2, ast.Div: 2}


class Writer(ABC):
    """Writes the functions of one program; a language states its words here, and has methods for what differs more."""

    language: ClassVar[str]
    prelude: ClassVar[str]
    indent: ClassVar[str] = "    "
    types: ClassVar[Mapping[Kind, str]]
    operators: ClassVar[dict[type[ast.AST], str]] = {
        ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^", ast.Eq: "==", ast.NotEq: "!=",
        ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.And: "&&", ast.Or: "||", ast.Not: "!",
        ast.USub: "-",
    }  # fmt: skip
    names: ClassVar[Mapping[str, str]]  # of Python's functions that are called otherwise
    reserved: ClassVar[frozenset[str]]  # names that a variable cannot have
    truths: ClassVar[tuple[str, str]] = ("false", "true")
    infinity: ClassVar[str]
    dot: ClassVar[str] = "."  # before a field of the model
    result: ClassVar[str] = "{}_{}"  # one of several results: variable of the call, number
    element: ClassVar[str]  # of an array: its name, index
    first: ClassVar[int] = 1  # index of an array
    choice: ClassVar[str]  # test, yes, no
    assign: ClassVar[str] = "="
    test: ClassVar[str]  # word, condition
    else_if: ClassVar[str] = "elseif"
    otherwise: ClassVar[str] = "else"
    end_if: ClassVar[str] = "end"
    end_for: ClassVar[str] = "end"

    def __init__(self, program: Program) -> None:
        self.program = program

    @classmethod
    def functions(cls, program: Program) -> str:
        """The text of all functions of a program, callees first."""
        writer = cls(program)
        return "\n".join([cls.prelude, *writer.tables(), *map(writer.function, program.functions.values())])

    def tables(self) -> list[str]:
        """The texts of the tables that stand before all functions."""
        return []

    @abstractmethod
    def function(self, written: Function) -> str:
        """The text of one function."""

    @abstractmethod
    def assignment(self, target: ast.expr | None, value: ast.expr) -> str:
        """The text of an assignment; without a target, of a call for what it changes."""

    def loop(self, variable: str, start: str, stop: str, step: int) -> str:
        """The head of a loop from `start` to before `stop`."""
        raise NotImplementedError

    def returned(self, items: Sequence[ast.expr]) -> list[str]:
        """The statements that return some results."""
        return [*(f"r{n} {self.assign} {self.expression(item)}" for n, item in enumerate(items, 1)), "return"]

    def called(self, value: ast.expr) -> Function | None:
        """The function of the program that an expression calls."""
        return self.program.functions.get(ast.unparse(value.func)) if isinstance(value, ast.Call) else None

    def block(self, statements: Sequence[ast.stmt], depth: int) -> list[str]:
        """The lines of some statements."""
        indent, lines = self.indent * depth, []
        for statement in statements:
            match statement:
                case ast.Pass():
                    continue
                case ast.Assign(targets=[target], value=value):
                    lines.append(f"{indent}{self.assignment(target, value)};")
                case ast.Expr(value=ast.Call() as call):
                    lines.append(f"{indent}{self.assignment(None, call)};")
                case ast.Return(value=value):
                    items = value.elts if isinstance(value, ast.Tuple) else [value] if value is not None else []
                    lines += [f"{indent}{line};" for line in self.returned(items)]
                case ast.If():
                    lines += self._branches(statement, depth, "if")
                case ast.For(target=ast.Name(id=key), iter=ast.Call(args=ends), body=body) if self.end_for:
                    start, stop = (ast.Constant(0), ends[0]) if len(ends) == 1 else (ends[0], ends[1])
                    step = ast.literal_eval(ends[2]) if len(ends) == 3 else 1
                    head = self.loop(self.variable(key), self.expression(start), self.bound(stop), step)
                    lines += [f"{indent}{head}", *self.block(body, depth + 1), f"{indent}{self.end_for}"]
                case _:
                    raise unsupported(f"`{ast.unparse(statement)}`", f"a function for {self.language}")
        return lines

    def _branches(self, statement: ast.If, depth: int, word: str) -> list[str]:
        indent = self.indent * depth
        head = self.test.format(word, self.expression(statement.test))
        lines = [f"{indent}{head}", *self.block(statement.body, depth + 1)]
        match statement.orelse:
            case [ast.If() as other]:
                return [*lines, *self._branches(other, depth, self.else_if)]
            case [_, *_] as statements:
                lines += [f"{indent}{self.otherwise}", *self.block(statements, depth + 1)]
        return [*lines, f"{indent}{self.end_if}"]

    def expression(self, node: ast.expr) -> str:
        """The text of an expression."""
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return self.number(value)
            case ast.Name(id=key):
                return self.variable(key)
            case ast.Attribute(value=ast.Name(id=inner), attr=key):
                return f"{inner}{self.dot}{key}"
            case ast.Subscript(value=ast.Name(id=key), slice=ast.Constant(value=n)) if key.rpartition("_")[2].isdigit():
                return self.result.format(key, n)
            case ast.Subscript(value=inner, slice=ast.Constant(value=int() as n)):
                return self.element.format(self.expression(inner), n + self.first)
            case ast.Subscript(value=inner, slice=index):
                shift = f" + {self.first}" if self.first else ""
                return self.element.format(self.expression(inner), f"{self.expression(index)}{shift}")
            case ast.UnaryOp(op=op, operand=inner):
                return self.operators[type(op)] + self.bound(inner)
            case ast.BinOp(left=left, op=op, right=right):
                level = _level(node)
                first = self.expression(left) if level and _level(left) >= level else self.bound(left)
                second = self.expression(right) if level and _level(right) > level else self.bound(right)
                return f"{first} {self.operators[type(op)]} {second}"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return f"{self.bound(left)} {self.operators[type(op)]} {self.bound(right)}"
            case ast.BoolOp(op=op, values=values):
                return f" {self.operators[type(op)]} ".join(map(self.bound, values))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return self.choice.format(*map(self.expression, (test, yes, no)))
            case ast.Call(func=called, args=arguments):
                return self.call(ast.unparse(called).removeprefix("math."), [*map(self.expression, arguments)])
            case _:
                raise unsupported(f"`{ast.unparse(node)}`", f"an expression for {self.language}")

    def call(self, called: str, arguments: list[str]) -> str:
        """The text of a call; the least and the largest are of two numbers."""
        name = self.names.get(called, called)
        if called not in ("min", "max"):
            return f"{name}({', '.join(arguments)})"
        text = arguments[0]
        for other in arguments[1:]:
            text = f"{name}({text}, {other})"
        return text

    def bound(self, node: ast.expr) -> str:
        """The text of an operand."""
        text = self.expression(node)
        atom = isinstance(node, ast.Name | ast.Attribute | ast.Subscript | ast.Call | ast.IfExp)
        return text if atom or (isinstance(node, ast.Constant) and not text.startswith("-")) else f"({text})"

    def variable(self, key: str) -> str:
        """The name of a variable."""
        return f"{key}_" if key in self.reserved else key

    @classmethod
    def number(cls, value: float) -> str:
        """The text of a number."""
        if isinstance(value, bool):
            return cls.truths[value]
        if math.isinf(value):
            return cls.infinity if value > 0 else f"-{cls.infinity}"
        return repr(value)


def _level(node: ast.expr) -> int:
    """Return how strongly a sum or a product binds; 0: something else."""
    return _LEVELS.get(type(node.op), 0) if isinstance(node, ast.BinOp) else 0
