"""Writes a program of the specialiser in MATLAB, which Octave reads, too.

Rule 1: MATLAB passes arrays by value, so a function that changes an array also returns it, before its other results.
Rule 2: MATLAB counts indices from 1, so an index is one larger than in Python.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence

from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import MODEL, unsupported

PRELUDE = """\
function r = choose(test, yes, no)
    if test, r = yes; else, r = no; end
end

function r = copysign(size, sign_of)
    r = abs(size) * (1 - 2 * (sign_of < 0));
end
"""
_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^", ast.Eq: "==", ast.NotEq: "~=",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
_RESERVED = frozenset(
    ["end", "function", "for", "if", "else", "while", "switch", "case", "otherwise", "return", "break"]
)
_NAMES = {"int": "fix", "float": "double"}


def functions(program: Program) -> str:
    """The text of all functions of a program, callees first, each closed by `end`."""
    return "\n".join([PRELUDE, *(_Text(program).function(written) for written in program.functions.values())])


class _Text:
    """Writes the functions of one program; the text of a call depends on the results of the called function."""

    def __init__(self, program: Program) -> None:
        self.program = program

    def function(self, written: Function) -> str:
        results = [*written.arrays, *(f"r{n}" for n, _ in enumerate(written.results, 1))]
        arguments = [*([MODEL] if written.uses_model else []), *written.arrays]
        arguments += [_variable(key) for key, _ in written.parameters]
        head = f"function [{', '.join(results)}] = {written.name}({', '.join(arguments)})"
        lines = [head, f"    % {written.summary}"]
        used = {n.id for statement in written.body for n in ast.walk(statement) if isinstance(n, ast.Name)}
        for key, row in self.program.tables.items():
            if key in used:
                lines.append(f"    {key} = [{', '.join(map(repr, row))}];")
        return "\n".join([*lines, *self.block(written.body, 1), "end", ""])

    def block(self, statements: Sequence[ast.stmt], depth: int) -> list[str]:
        indent, lines = "    " * depth, []
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
                    lines += [f"{indent}r{n} = {self.expression(item)};" for n, item in enumerate(items, 1)]
                    lines.append(f"{indent}return;")
                case ast.If(test=test, body=body, orelse=orelse):
                    lines += [f"{indent}if {self.expression(test)}", *self.block(body, depth + 1)]
                    lines += [f"{indent}else", *self.block(orelse, depth + 1)] if orelse else []
                    lines.append(f"{indent}end")
                case ast.For(target=ast.Name(id=key), iter=ast.Call(args=ends), body=body):
                    lines += [
                        f"{indent}for {_variable(key)} = {self.steps(ends)}",
                        *self.block(body, depth + 1),
                        f"{indent}end",
                    ]
                case _:
                    raise unsupported(f"`{ast.unparse(statement)}`", "a function for MATLAB")
        return lines

    def assignment(self, target: ast.expr | None, value: ast.expr) -> str:
        called = self.program.functions.get(ast.unparse(value.func)) if isinstance(value, ast.Call) else None
        if called is None:
            assert target is not None  # only functions of the program are called without a result
            return f"{self.expression(target)} = {self.expression(value)}"
        passed = _arguments(value)[int(called.uses_model) :]
        left = [self.expression(array) for array in passed[: len(called.arrays)]]
        if len(called.results) > 1 and isinstance(target, ast.Name):
            left += [f"{target.id}_{n}" for n, _ in enumerate(called.results)]
        elif target is not None:
            left.append(self.expression(target))
        return f"[{', '.join(left)}] = {self.expression(value)}"

    def steps(self, ends: Sequence[ast.expr]) -> str:
        start, stop = (ast.Constant(0), ends[0]) if len(ends) == 1 else (ends[0], ends[1])
        step = ast.literal_eval(ends[2]) if len(ends) == 3 else 1
        last = f"{self.bound(stop)} - 1" if step > 0 else f"{self.bound(stop)} + 1"
        return f"{self.expression(start)}:{'' if step == 1 else f'{step}:'}{last}"

    def expression(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return number(value)
            case ast.Name(id=key):
                return _variable(key)
            case ast.Attribute(value=ast.Name(id=inner), attr=key):
                return f"{inner}.{key}"
            case ast.Subscript(value=ast.Name(id=key), slice=ast.Constant(value=int() as n)) if key.rpartition("_")[
                2
            ].isdigit():
                return f"{key}_{n}"
            case ast.Subscript(value=inner, slice=ast.Constant(value=int() as n)):
                return f"{self.expression(inner)}({n + 1})"
            case ast.Subscript(value=inner, slice=index):
                return f"{self.expression(inner)}({self.expression(index)} + 1)"
            case ast.UnaryOp(op=op, operand=inner):
                return ("~" if isinstance(op, ast.Not) else "-") + self.bound(inner)
            case ast.BinOp(left=left, op=op, right=right):
                return f"{self.bound(left)} {_OPERATORS[type(op)]} {self.bound(right)}"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return f"{self.bound(left)} {_OPERATORS[type(op)]} {self.bound(right)}"
            case ast.BoolOp(op=op, values=values):
                return f" {_OPERATORS[type(op)]} ".join(map(self.bound, values))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return f"choose({self.expression(test)}, {self.expression(yes)}, {self.expression(no)})"
            case ast.Call(func=called, args=arguments):
                return self.call(ast.unparse(called).removeprefix("math."), arguments)
            case _:
                raise unsupported(f"`{ast.unparse(node)}`", "an expression for MATLAB")

    def call(self, called: str, arguments: Sequence[ast.expr]) -> str:
        texts = [self.expression(argument) for argument in arguments]
        if called in ("min", "max"):
            text = texts[0]
            for other in texts[1:]:
                text = f"{called}({text}, {other})"
            return text
        return f"{_NAMES.get(called, called)}({', '.join(texts)})"

    def bound(self, node: ast.expr) -> str:
        """The text of an operand: in brackets unless it is a name, a number, or a call."""
        text = self.expression(node)
        atom = isinstance(node, ast.Name | ast.Attribute | ast.Subscript | ast.Call | ast.IfExp)
        return text if atom or (isinstance(node, ast.Constant) and not text.startswith("-")) else f"({text})"


def _arguments(call: ast.expr) -> list[ast.expr]:
    return call.args if isinstance(call, ast.Call) else []


def _variable(key: str) -> str:
    return f"{key}_" if key in _RESERVED else key


def number(value: float) -> str:
    """A number as MATLAB writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isinf(value):
        return "Inf" if value > 0 else "-Inf"
    return repr(value)
