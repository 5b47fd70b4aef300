"""Specialises the body of a function: takes its statements, and returns those that remain.

Rule 1: a variable with a known value is not written, except within a branch or loop that may or may not run.
Rule 2: branches that cannot run are dropped; `tidy.py` drops unused assignments.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from typing import Any

from twin.export.translate import fold
from twin.export.translate.expressions import Calls, Expressions
from twin.export.translate.tidy import names, tidied
from twin.export.translate.values import (
    MODEL,
    Cells,
    Code,
    Kind,
    Known,
    Record,
    Several,
    Value,
    common,
    is_parameter,
    kind_of,
    name,
    node_of,
    unsupported,
)

LONGEST_UNROLLED = 4


class Body(Expressions):
    """The statements of a function, and those that remain of them."""

    def __init__(self, program: Calls, outside: Mapping[str, Any], local: dict[str, Value], *, where: str) -> None:
        super().__init__(program, outside, local, where=where)
        self.variables: dict[str, Kind] = {
            key: value.kind for key, value in local.items() if isinstance(value, Code) and not is_parameter(value.node)
        }
        self.pairs: list[str] = []
        self.results: tuple[Kind, ...] = ()
        self._out: list[ast.stmt] = []
        self._certain = True  # whether the statement at hand runs for sure, once

    def finished(self) -> list[ast.stmt]:
        """The statements that are left."""
        arrays = {key for value in self.local.values() if isinstance(value, Cells) for key in names(value.node)}
        return tidied(self._out, arrays - {MODEL})

    def emit(self, statement: ast.stmt) -> None:
        """Write a statement."""
        self._out.append(statement)

    def keep_results(self, call: ast.expr, called: str) -> str:
        """Write the call of a function with several results; returns the variable that holds them."""
        variable = f"{called}_{len(self.pairs) + 1}"
        self.pairs.append(variable)
        self.emit(ast.Assign([ast.Name(variable, ast.Store())], call, lineno=0))
        return variable

    def run(self, statements: Sequence[ast.stmt]) -> bool:
        """Translate statements; returns whether the last of them leaves the function in any case."""
        return any(self._statement(statement) for statement in statements)

    def _statement(self, statement: ast.stmt) -> bool:
        match statement:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(value=value):
                self.value_or_none(value)
            case ast.Assign(targets=[target], value=value):
                self._assign(target, self.value(value))
            case ast.AugAssign(target=target, op=op, value=value):
                before = ast.parse(ast.unparse(target), mode="eval").body
                self._assign(target, fold.arithmetic(op, self.value(before), self.value(value)))
            case ast.If():
                return self._if(statement)
            case ast.For():
                self._for(statement)
            case ast.Return():
                self._return(statement)
                return True
            case _:
                raise unsupported(f"`{ast.unparse(statement).splitlines()[0]}`", self.where)
        return False

    def _return(self, statement: ast.Return) -> None:
        if statement.value is None:
            self.emit(ast.Return(None))
            return
        value = self.value(statement.value)
        items = value.items if isinstance(value, Several) else (value,)
        kinds = tuple(map(kind_of, items))
        self.results = tuple(map(common, self.results, kinds)) if self.results else kinds
        nodes = [node_of(item) for item in items]
        self.emit(ast.Return(nodes[0] if len(nodes) == 1 else ast.Tuple(nodes, ast.Load())))

    # Assignments

    def _assign(self, target: ast.expr, value: Value) -> None:
        if not isinstance(target, ast.Tuple):
            self._assign_single(target, value)
            return
        if not isinstance(value, Several) or len(value.items) != len(target.elts):
            raise unsupported(f"`{ast.unparse(target)} = ..`", self.where)
        items = list(value.items)
        for n, item in enumerate(items):
            # Python evaluates the whole right side first: what an earlier target overwrites is kept.
            if isinstance(item, Code) and any(self._overwrites(t, item.node) for t in target.elts[:n]):
                before = f"before_{len(self.variables)}"
                self._write(before, item)
                items[n] = Code(name(before), item.kind)
        for single, item in zip(target.elts, items, strict=True):
            self._assign_single(single, item)

    def _overwrites(self, target: ast.expr, read: ast.expr) -> bool:
        """Return whether an assignment to `target` may change the value of `read`."""
        if isinstance(target, ast.Name):
            return any(isinstance(n, ast.Name) and n.id == target.id for n in ast.walk(read))
        cell = self._cell(target)
        for n in ast.walk(read):
            if isinstance(n, ast.Subscript) and ast.dump(n.value) == ast.dump(cell.value):
                both = isinstance(n.slice, ast.Constant) and isinstance(cell.slice, ast.Constant)
                if not both or ast.dump(n.slice) == ast.dump(cell.slice):
                    return True
        return False

    def _cell(self, target: ast.expr) -> ast.Subscript:
        array = self.value(target.value) if isinstance(target, ast.Subscript) else None
        if not isinstance(target, ast.Subscript) or not isinstance(array, Cells):
            raise unsupported(f"`{ast.unparse(target)} = ..`", self.where)
        return ast.Subscript(array.node, node_of(self.value(target.slice)), ast.Store())

    def _assign_single(self, target: ast.expr, value: Value) -> None:
        if not isinstance(target, ast.Name):
            self.emit(ast.Assign([self._cell(target)], node_of(value), lineno=0))
            return
        if isinstance(value, Code) and not is_parameter(value.node):
            self._write(target.id, value)
            return
        if not self._certain and not isinstance(value, Record | Several | Cells):
            self._write(target.id, value)
        self.local[target.id] = value

    def _write(self, variable: str, value: Value) -> None:
        kind = kind_of(value)
        self.variables[variable] = common(kind, self.variables.get(variable, kind))
        self.emit(ast.Assign([ast.Name(variable, ast.Store())], node_of(value), lineno=0))
        self.local[variable] = Code(name(variable), self.variables[variable])

    # Branches and loops

    def _if(self, statement: ast.If) -> bool:
        test = self.value(statement.test)
        if isinstance(test, Known):
            return self.run(statement.body if test.value else statement.orelse)
        self._write_down(_assigned(statement))
        first, leaves_first, after_first = self._branch(statement.body)
        second, leaves_second, after_second = self._branch(statement.orelse)
        if first or second:
            self.emit(ast.If(node_of(test), first or [ast.Pass()], second))
        if not (leaves_first and leaves_second):
            ends = [
                after for after, leaves in ((after_first, leaves_first), (after_second, leaves_second)) if not leaves
            ]
            self._merge(ends)
        return leaves_first and leaves_second

    def _branch(self, statements: Sequence[ast.stmt]) -> tuple[list[ast.stmt], bool, dict[str, Value]]:
        """Return (statements that are left, whether they leave the function, local names at their end)."""
        out, certain, local = self._out, self._certain, dict(self.local)
        self._out, self._certain = [], False
        leaves = self.run(statements)
        result = self._out, leaves, self.local
        self._out, self._certain, self.local = out, certain, local
        return result

    def _merge(self, ends: list[dict[str, Value]]) -> None:
        for key in {key for end in ends for key in end}:
            values = [end[key] for end in ends if key in end]
            # Known behind a branch only if all ways to here agree.
            equal = all(value == values[0] for value in values) and len(values) == len(ends)
            self.local[key] = values[0] if equal else Code(name(key), self.variables[key])

    def _write_down(self, variables: set[str]) -> None:
        """Write the known values of variables that a branch or a loop may change."""
        for variable in sorted(variables & set(self.local)):
            value = self.local[variable]
            if not isinstance(value, Code) or is_parameter(value.node):
                self._write(variable, value)

    def _for(self, statement: ast.For) -> None:
        steps = self._steps(statement.iter)
        # Short loops are written out: their indices are known then, so parts of absent causes vanish.
        if isinstance(steps, list):
            for step in steps:
                self._assign(statement.target, step)
                self.run(statement.body)
            return
        assert isinstance(statement.target, ast.Name)
        self._write_down(_assigned(statement))
        self.variables[statement.target.id] = "int"
        self.local[statement.target.id] = Code(name(statement.target.id), "int")
        # Values that are known before a loop hold in its first turn only.
        for variable in _assigned(statement) - {statement.target.id}:
            if variable in self.local:
                self.local[variable] = Code(name(variable), self.variables[variable])
        body, _, after = self._branch(statement.body)
        self._merge([after, dict(self.local)])
        self.emit(ast.For(ast.Name(statement.target.id, ast.Store()), steps, body or [ast.Pass()], [], lineno=0))

    def _steps(self, node: ast.expr) -> list[Value] | ast.expr:
        """Return the values that a short loop goes through, or the range of a loop that stays one."""
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range":
            ends = [self.value(argument) for argument in node.args]
            numbers = [end.value for end in ends if isinstance(end, Known)]
            if len(numbers) == len(ends) and len(range(*numbers)) <= LONGEST_UNROLLED:
                return [Known(n) for n in range(*numbers)]
            return ast.Call(name("range"), [node_of(end) for end in ends], [])
        value = self.value(node)
        if not isinstance(value, Several):
            raise unsupported(f"`for .. in {ast.unparse(node)}`", self.where)
        return list(value.items)


def _assigned(statement: ast.stmt) -> set[str]:
    return {n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
