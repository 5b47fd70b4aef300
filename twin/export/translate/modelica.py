"""A program of the specialiser as Modelica functions (Modelica 3.4, chapter 12).

Rule: functions of Modelica change no argument, so a function with an array is refused: only equations are translated.
"""

from __future__ import annotations

import ast
from typing import ClassVar

from twin.export.translate.specialise import Function
from twin.export.translate.values import MODEL, unsupported
from twin.export.translate.writer import Writer


class _Modelica(Writer):
    language = "Modelica"
    prelude = """\
function copysign "The size of one number with the sign of another"
  input Real size;
  input Real signOf;
  output Real r1;
algorithm
  r1 := if signOf < 0 then -abs(size) else abs(size);
end copysign;
"""
    indent = "  "
    types: ClassVar = {"float": "Real", "int": "Integer", "bool": "Boolean"}
    operators: ClassVar = Writer.operators | {ast.NotEq: "<>", ast.And: "and", ast.Or: "or", ast.Not: "not "}
    names: ClassVar = {"floor": "integer", "int": "integer", "float": ""}
    reserved = frozenset(
        ["end", "final", "each", "inner", "outer", "initial", "connect", "block", "type", "der", "time"]
    )
    infinity = "1e300"  # Modelica has none: the largest number stands for it
    element = "{}[{}]"
    choice = "(if {} then {} else {})"
    assign = ":="
    test = "{} {} then"
    end_if = "end if;"
    end_for = ""  # no equation has a loop

    def function(self, written: Function) -> str:
        if written.arrays:
            raise unsupported("an array that it changes", written.name)
        summary = written.summary.replace("\\", "/").replace('"', "'")
        lines = [f'function {written.name} "{summary}"']
        lines += [f"  input Parameters {MODEL};"] if written.uses_model else []
        lines += [f"  input {self.types[kind]} {key}_in;" for key, kind in written.parameters]
        lines += [f"  output {self.types[kind]} r{n};" for n, kind in enumerate(written.results, 1)]
        variables = dict(written.parameters) | dict(written.variables)
        lines += ["protected", *(f"  {self.types[kind]} {self.variable(key)};" for key, kind in variables.items())]
        for key in written.pairs:
            called = next(other for other in self.program.functions.values() if key.startswith(f"{other.name}_"))
            lines += [f"  {self.types[kind]} {key}_{n};" for n, kind in enumerate(called.results)]
        # An input cannot be assigned to, so each is copied first.
        lines += ["algorithm", *(f"  {self.variable(key)} := {key}_in;" for key, _ in written.parameters)]
        return "\n".join([*lines, *self.block(written.body, 1), f"end {written.name};", ""])

    def assignment(self, target: ast.expr | None, value: ast.expr) -> str:
        assert target is not None  # only functions that change an array are called without a result
        called, left = self.called(value), self.expression(target)
        if called is not None and len(called.results) > 1:
            left = f"({', '.join(f'{left}_{n}' for n, _ in enumerate(called.results))})"
        return f"{left} := {self.expression(value)}"

    def call(self, called: str, arguments: list[str]) -> str:
        if called == "isinf":
            return f"(abs({arguments[0]}) > {self.infinity})"
        return super().call(called, arguments)


functions, number = _Modelica.functions, _Modelica.number
