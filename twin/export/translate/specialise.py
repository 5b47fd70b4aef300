"""Functions specialised for one model: what is known of their arguments is computed now, and the rest stays as code.

Rule 1: the written code is made from the source of the function that the twin runs.  A cause that the model does not
        have is known to be neutral, so its terms and branches vanish.
Rule 2: a function whose result is one expression, in which each argument stands at most once, becomes part of its
        callers.  All others stay functions, once for each combination of known arguments.
"""

from __future__ import annotations

import ast
import copy
import inspect
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from twin.export.translate.expressions import Expressions
from twin.export.translate.statements import Body
from twin.export.translate.values import (
    MODEL,
    Cells,
    Code,
    Kind,
    Known,
    Record,
    Several,
    Value,
    is_parameter,
    kind_of,
    name,
    node_of,
    unsupported,
)

LONGEST_INLINED = 90  # characters


@dataclass(frozen=True, slots=True, kw_only=True)
class Function:
    """A specialised function."""

    name: str
    summary: str  # first line of its docstring
    parameters: tuple[tuple[str, Kind], ...]
    arrays: tuple[str, ...]  # parameters that are arrays, which it may change
    variables: Mapping[str, Kind]
    pairs: frozenset[str]  # variables that hold the results of a function with several
    results: tuple[Kind, ...]
    body: Sequence[ast.stmt]
    uses_model: bool

    @property
    def arguments(self) -> list[str]:
        """The names of all that it takes, in their order."""
        return [*([MODEL] if self.uses_model else []), *self.arrays, *(key for key, _ in self.parameters)]

    @property
    def call(self) -> str:
        """The text of a call with variables of these names, which is the same in each language but C."""
        return f"{self.name}({', '.join(self.arguments)})"


@dataclass(slots=True)
class Program:
    """The functions that a model needs, callees first."""

    functions: dict[str, Function] = field(default_factory=dict)
    tables: dict[str, tuple[float, ...]] = field(default_factory=dict)
    _known: dict[tuple[Any, ...], tuple[Function, Value | None]] = field(default_factory=dict)

    def add(self, function: Callable[..., Any], arguments: Sequence[Value]) -> Function:
        """Specialise `function` and all that it calls.

        Args:
            function: a kernel, or a plain Python function of the same kind.
            arguments: one value for each of its parameters; a variable is a `Code` of its own name.

        Raises:
            NotTranslatableError: its source uses a construct that no other language has.
        """
        return self._specialised(function, arguments)[0]

    def call(self, function: Callable[..., Any], arguments: Sequence[Value], caller: Expressions) -> Value | None:
        """Return the value of a call; its function becomes part of the program unless it vanishes."""
        written, simple = self._specialised(function, arguments)
        parameters = [parameter for parameter, _ in _parameters(function)]
        run_time = {
            key: node_of(value)
            for key, value in zip(parameters, arguments, strict=True)
            if isinstance(value, Code) and not is_parameter(value.node)
        }
        if simple is not None:
            del self.functions[written.name]
            return _put_in(simple, run_time)
        passed = dict(zip(parameters, arguments, strict=True))
        nodes = [_array_or_number(passed[key]) if key in passed else name(MODEL) for key in written.arguments]
        node = ast.Call(name(written.name), nodes, [])
        if not written.results:
            caller.emit(ast.Expr(node))
            return None
        if len(written.results) == 1:
            return Code(node, written.results[0])
        variable = caller.keep_results(node, written.name)
        return Several(
            tuple(
                Code(ast.Subscript(name(variable), ast.Constant(n), ast.Load()), kind)
                for n, kind in enumerate(written.results)
            )
        )

    def _specialised(self, function: Callable[..., Any], arguments: Sequence[Value]) -> tuple[Function, Value | None]:
        # A compiled kernel keeps its Python source.
        function = getattr(function, "py_func", function)
        signature = (function.__module__, function.__qualname__, *map(_signature, arguments))
        # Calls with the same known arguments share one function.
        if signature not in self._known:
            self._known[signature] = self._translated(function, arguments)
        written, simple = self._known[signature]
        self.functions.setdefault(written.name, written)
        return written, simple

    def _translated(self, function: Callable[..., Any], arguments: Sequence[Value]) -> tuple[Function, Value | None]:
        definition = _definition(function)
        local: dict[str, Value] = {}
        parameters: list[tuple[str, Kind]] = []
        arrays: list[str] = []
        for (key, _), value in zip(_parameters(function), arguments, strict=True):
            local[key] = value
            if isinstance(value, Code) and not is_parameter(value.node):
                local[key] = Code(name(key), value.kind)
                parameters.append((key, value.kind))
            elif isinstance(value, Cells) and not is_parameter(value.node):
                local[key] = Cells(name(key), value.constants)
                arrays.append(key)
        body = Body(self, function.__globals__, local, where=function.__qualname__)
        body.run(definition.body)
        statements = body.finished()
        # What only absent causes used is no argument any more.
        parameters = [(key, kind) for key, kind in parameters if _is_used(key, statements)]
        written = Function(
            name=self._free_name(f"{function.__module__.rpartition('.')[2]}_{function.__name__.strip('_')}"),
            summary=(ast.get_docstring(definition) or "").partition("\n")[0],
            parameters=tuple(parameters),
            arrays=tuple(arrays),
            variables={key: kind for key, kind in body.variables.items() if _is_used(key, statements)},
            pairs=frozenset(body.pairs),
            results=body.results,
            body=statements,
            uses_model=_is_used(MODEL, statements),
        )
        return written, None if arrays else _simple(statements, body.results, [key for key, _ in parameters])

    def _free_name(self, stem: str) -> str:
        names = {written.name for written, _ in self._known.values()}
        number = 2
        free = stem
        while free in names:
            free, number = f"{stem}_{number}", number + 1
        return free


def _parameters(function: Callable[..., Any]) -> list[tuple[str, Any]]:
    return [(arg.arg, arg.annotation) for arg in _definition(getattr(function, "py_func", function)).args.args]


@cache
def _definition(function: Callable[..., Any]) -> ast.FunctionDef:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if not isinstance(definition, ast.FunctionDef):
        raise unsupported("something else than a function", getattr(function, "__qualname__", "it"))
    return definition


def _signature(value: Value) -> Any:
    match value:
        case Known(known):
            return ("known", type(known).__name__, known)
        case Code(node, kind):
            return ("code", kind, ast.dump(node) if is_parameter(node) else "")
        case Record(fields):
            return ("record", tuple((key, _signature(item)) for key, item in fields.items()))
        case Several(items):
            return ("several", tuple(map(_signature, items)))
        case Cells(node, constants):
            return ("cells", ast.dump(node) if is_parameter(node) else "", tuple(sorted(constants.items())))


def _array_or_number(value: Value) -> ast.expr:
    return value.node if isinstance(value, Cells) else node_of(value)


def _is_used(variable: str, statements: Sequence[ast.stmt]) -> bool:
    return any(isinstance(n, ast.Name) and n.id == variable for statement in statements for n in ast.walk(statement))


def _simple(statements: Sequence[ast.stmt], results: tuple[Kind, ...], parameters: list[str]) -> Value | None:
    """Return the value of a function that is one expression, in which no argument would be computed twice."""
    match statements:
        case [ast.Return(value=ast.Tuple(elts=items))]:
            nodes = items
        case [ast.Return(value=ast.expr() as node)]:
            nodes = [node]
        case _:
            return None
    used = [n.id for node in nodes for n in ast.walk(node) if isinstance(n, ast.Name)]
    # A long expression remains a function: its name says what it computes.
    too_long = sum(len(ast.unparse(node)) for node in nodes) > LONGEST_INLINED
    if too_long or any(isinstance(node, ast.IfExp) for node in nodes) or any(used.count(key) > 1 for key in parameters):
        return None
    values = tuple(
        Known(node.value) if isinstance(node, ast.Constant) else Code(node, kind)
        for node, kind in zip(nodes, results, strict=True)
    )
    return values[0] if len(values) == 1 else Several(values)


class _Exchange(ast.NodeTransformer):
    def __init__(self, nodes: Mapping[str, ast.expr]) -> None:
        self.nodes = nodes

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.nodes.get(node.id, node)


def _put_in(value: Value, nodes: Mapping[str, ast.expr]) -> Value:
    """Return `value` with the arguments of a call in place of the parameters."""
    if isinstance(value, Several):
        return Several(tuple(_put_in(item, nodes) for item in value.items))
    if isinstance(value, Known):
        return value
    # A copy, because the expression is put in at each call.
    copied = copy.deepcopy(node_of(value))
    return Code(_Exchange(nodes).visit(copied), kind_of(value))
