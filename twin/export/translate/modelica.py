"""A program of the specialiser as Modelica functions (Modelica 3.4, chapter 12).

Rule: functions of Modelica change no argument, so a function with an array is refused: only equations are translated.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence

from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import MODEL, Kind, unsupported

PRELUDE = """\
function copysign "The size of one number with the sign of another"
  input Real size;
  input Real signOf;
  output Real r1;
algorithm
  r1 := if signOf < 0 then -abs(size) else abs(size);
end copysign;
"""
_TYPES: Mapping[Kind, str] = {"float": "Real", "int": "Integer", "bool": "Boolean"}
_OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^", ast.Eq: "==", ast.NotEq: "<>",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.And: "and", ast.Or: "or",
}  # fmt: skip
_NAMES = {"floor": "integer", "ceil": "ceil", "int": "integer", "float": ""}
_RESERVED = frozenset(["end", "final", "each", "inner", "outer", "initial", "connect", "block", "type", "der", "time"])


def functions(program: Program) -> str:
    """The text of all functions of a program, callees first."""
    return "\n".join([PRELUDE, *(_function(program, written) for written in program.functions.values())])


def _function(program: Program, written: Function) -> str:
    if written.arrays:
        raise unsupported("an array that it changes", written.name)
    summary = written.summary.replace("\\", "/").replace('"', "'")
    lines = [f'function {written.name} "{summary}"', *([f"  input Parameters {MODEL};"] if written.uses_model else [])]
    lines += [f"  input {_TYPES[kind]} {key}_in;" for key, kind in written.parameters]
    lines += [f"  output {_TYPES[kind]} r{n};" for n, kind in enumerate(written.results, 1)]
    variables = dict(written.parameters) | dict(written.variables)
    lines += ["protected", *(f"  {_TYPES[kind]} {_variable(key)};" for key, kind in variables.items())]
    for key in written.pairs:
        called = next(other for other in program.functions.values() if key.startswith(f"{other.name}_"))
        lines += [f"  {_TYPES[kind]} {key}_{n};" for n, kind in enumerate(called.results)]
    # An input cannot be assigned to, so each is copied first.
    lines += ["algorithm", *(f"  {_variable(key)} := {key}_in;" for key, _ in written.parameters)]
    return "\n".join([*lines, *_block(program, written.body, 1), f"end {written.name};", ""])


def _block(program: Program, statements: Sequence[ast.stmt], depth: int) -> list[str]:
    indent, lines = "  " * depth, []
    for statement in statements:
        match statement:
            case ast.Pass():
                continue
            case ast.Assign(targets=[ast.Name(id=key)], value=ast.Call(func=ast.Name(id=called)) as value) if (
                called in program.functions and len(program.functions[called].results) > 1
            ):
                left = ", ".join(f"{key}_{n}" for n, _ in enumerate(program.functions[called].results))
                lines.append(f"{indent}({left}) := {_text(value)};")
            case ast.Assign(targets=[target], value=value):
                lines.append(f"{indent}{_text(target)} := {_text(value)};")
            case ast.Return(value=ast.expr() as value):
                items = value.elts if isinstance(value, ast.Tuple) else [value]
                lines += [f"{indent}r{n} := {_text(item)};" for n, item in enumerate(items, 1)]
                lines.append(f"{indent}return;")
            case ast.If(test=test, body=body, orelse=orelse):
                lines += [f"{indent}if {_text(test)} then", *_block(program, body, depth + 1)]
                lines += [f"{indent}else", *_block(program, orelse, depth + 1)] if orelse else []
                lines.append(f"{indent}end if;")
            case _:
                raise unsupported(f"`{ast.unparse(statement)}`", "a function for Modelica")
    return lines


def _text(node: ast.expr) -> str:
    match node:
        case ast.Constant(value=bool() | int() | float() as value):
            return number(value)
        case ast.Name(id=key):
            return _variable(key)
        case ast.Attribute(value=ast.Name(id=inner), attr=key):
            return f"{inner}.{key}"
        case ast.Subscript(value=ast.Name(id=key), slice=ast.Constant(value=int() as n)):
            return f"{key}_{n}"
        case ast.Subscript(value=inner, slice=ast.Constant(value=int() as n)):
            return f"{_text(inner)}[{n + 1}]"
        case ast.Subscript(value=inner, slice=index):
            return f"{_text(inner)}[{_text(index)} + 1]"
        case ast.UnaryOp(op=op, operand=inner):
            return ("not " if isinstance(op, ast.Not) else "-") + _bound(inner)
        case ast.BinOp(left=left, op=op, right=right) | ast.Compare(left=left, ops=[op], comparators=[right]):
            return f"{_bound(left)} {_OPERATORS[type(op)]} {_bound(right)}"
        case ast.BoolOp(op=op, values=values):
            return f" {_OPERATORS[type(op)]} ".join(map(_bound, values))
        case ast.IfExp(test=test, body=yes, orelse=no):
            return f"(if {_text(test)} then {_text(yes)} else {_text(no)})"
        case ast.Call(func=called, args=arguments):
            return _call(ast.unparse(called).removeprefix("math."), [_text(argument) for argument in arguments])
        case _:
            raise unsupported(f"`{ast.unparse(node)}`", "an expression for Modelica")


def _call(called: str, texts: list[str]) -> str:
    if called in ("min", "max"):
        text = texts[0]
        for other in texts[1:]:
            text = f"{called}({text}, {other})"
        return text
    if called == "isinf":
        return f"(abs({texts[0]}) > {number(math.inf)})"
    return f"{_NAMES.get(called, called)}({', '.join(texts)})"


def _bound(node: ast.expr) -> str:
    text = _text(node)
    atom = isinstance(node, ast.Name | ast.Attribute | ast.Subscript | ast.IfExp | ast.Call)
    return text if atom or (isinstance(node, ast.Constant) and not text.startswith("-")) else f"({text})"


def _variable(key: str) -> str:
    return f"{key}_" if key in _RESERVED else key


def number(value: float) -> str:
    """A number as Modelica writes it; Modelica has no infinity, and the largest number stands for it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isinf(value):
        return "1e300" if value > 0 else "-1e300"
    return repr(value)
