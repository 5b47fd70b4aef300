"""A program of the specialiser as C99.  Only `double`, `int` and calls of `math.h` come out."""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Sequence
from typing import ClassVar

from twin.export.translate.specialise import Function
from twin.export.translate.values import MODEL
from twin.export.translate.writer import Writer


class _C(Writer):
    language = "C"
    prelude = """\
/* Results of a function with several. */
typedef struct { double v[4]; } Results;

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }
"""
    types: ClassVar = {"float": "double", "int": "int", "bool": "int"}
    names: ClassVar = {
        "floor": "(int)floor", "ceil": "(int)ceil", "abs": "fabs", "int": "(int)", "min": "smaller", "max": "larger",
    }  # fmt: skip
    reserved = frozenset(
        {"short", "long", "double", "float", "int", "char", "signed", "register", "auto", "free", "y1"}
    )
    truths = ("0", "1")
    infinity = "INFINITY"
    dot = "->"
    result = "{}.v[{}]"
    element = "{}[{}]"
    first = 0
    choice = "({} ? {} : {})"
    test = "{} ({}) {{"
    else_if = "} else if"
    otherwise = "} else {"
    end_if = end_for = "}"

    def tables(self) -> list[str]:
        return [
            f"static const double {key}[{len(row)}] = {{{', '.join(map(self.number, row))}}};\n"
            for key, row in self.program.tables.items()
        ]

    def function(self, written: Function) -> str:
        kinds = written.results
        result = "void" if not kinds else "Results" if len(kinds) > 1 else self.types[kinds[0]]
        arguments = [f"const Model *{MODEL}"] if written.uses_model else []
        arguments += [f"double *{self.variable(key)}" for key in written.arrays]
        arguments += [f"{self.types[kind]} {self.variable(key)}" for key, kind in written.parameters]
        lines = [f"/* {written.summary} */", f"static {result} {written.name}({', '.join(arguments) or 'void'})", "{"]
        for kind in ("float", "int", "bool"):
            named = [
                f"{self.variable(key)} = 0"
                for key, of in written.variables.items()
                if of == kind and key not in dict(written.parameters)
            ]
            if named:
                text = f"{self.types[kind]} {', '.join(named)};"
                lines += textwrap.wrap(text, 110, initial_indent="    ", subsequent_indent="        ")
        return "\n".join([*lines, *self.block(written.body, 1), "}", ""])

    def assignment(self, target: ast.expr | None, value: ast.expr) -> str:
        called = self.called(value)
        of_results = "const Results " if called is not None and len(called.results) > 1 else ""
        left = f"{of_results}{self.expression(target)} = " if target is not None else ""
        return f"{left}{self.expression(value)}"

    def returned(self, items: Sequence[ast.expr]) -> list[str]:
        values = ", ".join(map(self.expression, items))
        return [f"return (Results){{{{{values}}}}}" if len(items) > 1 else f"return {values}".rstrip()]

    def loop(self, variable: str, start: str, stop: str, step: int) -> str:
        return f"for ({variable} = {start}; {variable} {'<' if step > 0 else '>'} {stop}; {variable} += {step}) {{"

    def expression(self, node: ast.expr) -> str:
        match node:
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self.call("pow", [self.expression(left), self.expression(right)])
        return super().expression(node)

    def bound(self, node: ast.expr) -> str:
        is_power = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)
        return self.expression(node) if is_power else super().bound(node)


functions, number = _C.functions, _C.number
