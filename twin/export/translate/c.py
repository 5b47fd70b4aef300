"""A program of the specialiser as C99.  Only `double`, `int` and calls of `math.h` come out."""

from __future__ import annotations

import ast
import math
import textwrap
from collections.abc import Mapping, Sequence

from twin.export.translate.specialise import Function, Program
from twin.export.translate.values import MODEL, Kind, unsupported

PRELUDE = """\
/* Results of a function with several. */
typedef struct { double v[4]; } Results;

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }
"""
_TYPES: Mapping[Kind, str] = {"float": "double", "int": "int", "bool": "int"}
_OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<",
    ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
# C has no precedence that Python lacks here: these are only the levels at which brackets are needed.
_TERM, _FACTOR, _UNARY, _ATOM, _LOGIC, _COMPARE = 4, 5, 6, 7, 2, 3
_CASTS = {"math.floor": "(int)floor", "math.ceil": "(int)ceil", "math.isinf": "isinf", "abs": "fabs", "int": "(int)"}
_RESERVED = frozenset({"short", "long", "double", "float", "int", "char", "signed", "register", "auto", "free", "y1"})


def functions(program: Program) -> str:
    """The C text of all functions of a program, callees first."""
    tables = [
        f"static const double {key}[{len(row)}] = {{{', '.join(map(number, row))}}};\n"
        for key, row in program.tables.items()
    ]
    return "\n".join([PRELUDE, *tables, *map(function, program.functions.values())])


def function(written: Function) -> str:
    """The C text of one function."""
    result = "void" if not written.results else "Results" if len(written.results) > 1 else _TYPES[written.results[0]]
    arguments = [f"const Model *{MODEL}"] if written.uses_model else []
    arguments += [f"double *{_variable(key)}" for key in written.arrays]
    arguments += [f"{_TYPES[kind]} {_variable(key)}" for key, kind in written.parameters]
    lines = [f"/* {written.summary} */", f"static {result} {written.name}({', '.join(arguments) or 'void'})", "{"]
    for kind in ("float", "int", "bool"):
        named = [
            f"{_variable(key)} = 0"
            for key, of in written.variables.items()
            if of == kind and key not in dict(written.parameters)
        ]
        if named:
            text = f"{_TYPES[kind]} {', '.join(named)};"
            lines += textwrap.wrap(text, 110, initial_indent="    ", subsequent_indent="        ")
    lines += _block(written.body, 1, written.pairs)
    return "\n".join([*lines, "}", ""])


def _block(statements: Sequence[ast.stmt], depth: int, pairs: frozenset[str]) -> list[str]:
    indent, lines = "    " * depth, []
    for statement in statements:
        match statement:
            case ast.Pass():
                continue
            case ast.Assign(targets=[ast.Name(id=key)], value=value) if key in pairs:
                lines.append(f"{indent}const Results {key} = {expression(value)};")
            case ast.Assign(targets=[target], value=value):
                lines.append(f"{indent}{expression(target)} = {expression(value)};")
            case ast.Expr(value=value):
                lines.append(f"{indent}{expression(value)};")
            case ast.Return(value=None):
                lines.append(f"{indent}return;")
            case ast.Return(value=ast.Tuple(elts=items)):
                lines.append(f"{indent}return (Results){{{{{', '.join(map(expression, items))}}}}};")
            case ast.Return(value=ast.expr() as value):
                lines.append(f"{indent}return {expression(value)};")
            case ast.If():
                lines += _branches(statement, depth, pairs)
            case ast.For(target=ast.Name(id=key), iter=ast.Call(args=ends), body=body):
                lines.append(f"{indent}for ({_steps(_variable(key), ends)}) {{")
                lines += [*_block(body, depth + 1, pairs), f"{indent}}}"]
            case _:
                raise unsupported(f"`{ast.unparse(statement)}`", "a function for C")
    return lines


def _branches(statement: ast.If, depth: int, pairs: frozenset[str]) -> list[str]:
    indent = "    " * depth
    lines = [f"{indent}if ({expression(statement.test)}) {{", *_block(statement.body, depth + 1, pairs)]
    match statement.orelse:
        case []:
            return [*lines, f"{indent}}}"]
        case [ast.If() as other]:
            first, *rest = _branches(other, depth, pairs)
            return [*lines, f"{indent}}} else {first.strip()}", *rest]
        case others:
            return [*lines, f"{indent}}} else {{", *_block(others, depth + 1, pairs), f"{indent}}}"]


def _steps(variable: str, ends: Sequence[ast.expr]) -> str:
    start, stop = (ast.Constant(0), ends[0]) if len(ends) == 1 else (ends[0], ends[1])
    step = ast.literal_eval(ends[2]) if len(ends) == 3 else 1
    compare = "<" if step > 0 else ">"
    return f"{variable} = {expression(start)}; {variable} {compare} {expression(stop)}; {variable} += {step}"


def expression(node: ast.expr) -> str:
    """The C text of an expression."""
    return _expression(node)[0]


def _expression(node: ast.expr) -> tuple[str, int]:
    """Return (text, how strongly it binds)."""
    match node:
        case ast.Constant(value=bool() | int() | float() as value):
            return number(value), _ATOM if value >= 0 else _UNARY
        case ast.Name(id=key):
            return _variable(key), _ATOM
        case ast.Attribute(value=ast.Name(id=inner), attr=key):
            return f"{inner}->{key}", _ATOM
        case ast.Subscript(value=ast.Name(id=key), slice=ast.Constant(value=int() as n)) if key.rpartition("_")[
            2
        ].isdigit():
            return f"{key}.v[{n}]", _ATOM
        case ast.Subscript(value=inner, slice=index):
            return f"{expression(inner)}[{expression(index)}]", _ATOM
        case ast.UnaryOp(op=op, operand=inner):
            return ("!" if isinstance(op, ast.Not) else "-") + _bound(inner, _UNARY), _UNARY
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            return f"pow({expression(left)}, {expression(right)})", _ATOM
        case ast.BinOp(left=left, op=op, right=right):
            level = _TERM if isinstance(op, ast.Add | ast.Sub) else _FACTOR
            return f"{_bound(left, level)} {_OPERATORS[type(op)]} {_bound(right, level + 1)}", level
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            return f"{_bound(left, _TERM)} {_OPERATORS[type(op)]} {_bound(right, _TERM)}", _COMPARE
        case ast.BoolOp(op=op, values=values):
            return f" {_OPERATORS[type(op)]} ".join(_bound(value, _COMPARE) for value in values), _LOGIC
        case ast.IfExp(test=test, body=yes, orelse=no):
            return f"({_bound(test, _LOGIC)} ? {_bound(yes, _LOGIC)} : {_bound(no, _LOGIC)})", _ATOM
        case ast.Call(func=called, args=arguments):
            return _call(ast.unparse(called), [expression(argument) for argument in arguments]), _ATOM
        case _:
            raise unsupported(f"`{ast.unparse(node)}`", "an expression for C")


def _bound(node: ast.expr, level: int) -> str:
    text, binds = _expression(node)
    return text if binds >= level else f"({text})"


def _call(called: str, arguments: list[str]) -> str:
    if called in ("min", "max"):
        text = arguments[0]
        for other in arguments[1:]:
            text = f"{'smaller' if called == 'min' else 'larger'}({text}, {other})"
        return text
    plain = _CASTS.get(called, called.removeprefix("math."))
    return f"{plain}({', '.join(arguments)})"


def _variable(key: str) -> str:
    return f"{key}_" if key in _RESERVED else key


def number(value: float) -> str:
    """A number as a C constant; a `float` is never an integer constant."""
    if isinstance(value, bool | int):
        return str(int(value))
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(value)
