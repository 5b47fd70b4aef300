"""Writes a program of the specialiser in MATLAB, which Octave reads, too.

Rule 1: MATLAB passes arrays by value, so a function that changes an array also returns it, before its other results.
Rule 2: MATLAB counts indices from 1, so an index is one larger than in Python.
"""

from __future__ import annotations

import ast
from typing import ClassVar

from twin.export.translate.specialise import Function
from twin.export.translate.values import MODEL
from twin.export.translate.writer import Writer


class _Matlab(Writer):
    language = "MATLAB"
    prelude = """\
function r = choose(test, yes, no)
    if test, r = yes; else, r = no; end
end

function r = copysign(size, sign_of)
    r = abs(size) * (1 - 2 * (sign_of < 0));
end
"""
    operators: ClassVar = Writer.operators | {ast.NotEq: "~=", ast.Not: "~"}
    names: ClassVar = {"int": "fix", "float": "double"}
    reserved = frozenset(
        ["end", "function", "for", "if", "else", "while", "switch", "case", "otherwise", "return", "break"]
    )
    infinity = "Inf"
    element = "{}({})"
    choice = "choose({}, {}, {})"
    test = "{} {}"

    def function(self, written: Function) -> str:
        results = [*written.arrays, *(f"r{n}" for n, _ in enumerate(written.results, 1))]
        arguments = [*([MODEL] if written.uses_model else []), *written.arrays]
        arguments += [self.variable(key) for key, _ in written.parameters]
        head = f"function [{', '.join(results)}] = {written.name}({', '.join(arguments)})"
        lines = [head, f"    % {written.summary}"]
        used = {n.id for statement in written.body for n in ast.walk(statement) if isinstance(n, ast.Name)}
        for key, row in self.program.tables.items():
            if key in used:
                lines.append(f"    {key} = [{', '.join(map(repr, row))}];")
        return "\n".join([*lines, *self.block(written.body, 1), "end", ""])

    def assignment(self, target: ast.expr | None, value: ast.expr) -> str:
        called = self.called(value)
        if called is None:
            assert target is not None  # only functions of the program are called without a result
            return f"{self.expression(target)} = {self.expression(value)}"
        assert isinstance(value, ast.Call)
        passed = value.args[int(called.uses_model) :]
        left = [self.expression(array) for array in passed[: len(called.arrays)]]
        if len(called.results) > 1 and isinstance(target, ast.Name):
            left += [f"{target.id}_{n}" for n, _ in enumerate(called.results)]
        elif target is not None:
            left.append(self.expression(target))
        return f"[{', '.join(left)}] = {self.expression(value)}"

    def loop(self, variable: str, start: str, stop: str, step: int) -> str:
        stride = "" if step == 1 else f"{step}:"
        return f"for {variable} = {start}:{stride}{stop} {'-' if step > 0 else '+'} 1"


functions, number = _Matlab.functions, _Matlab.number
