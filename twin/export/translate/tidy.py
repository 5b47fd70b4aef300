"""Simplifies translated statements: drops unused assignments, and inlines a value that only the next statement reads.

Rule: an expression with a call that receives an array is never dropped or moved, because the call may change the array.
"""

from __future__ import annotations

import ast
import copy
from collections import Counter
from collections.abc import Sequence

LONGEST = 100  # characters of a statement that took up another one


def tidied(statements: Sequence[ast.stmt], arrays: set[str]) -> list[ast.stmt]:
    """Return the simplified statements; `arrays`: names of arrays that calls may change."""
    before: list[str] = []
    left = list(statements)
    # Until nothing changes: a dropped assignment may have been the only reader of another one.
    while (now := [ast.dump(statement) for statement in left]) != before:
        before = now
        left = _merged(_without_unread(left, _read(left), arrays), _loads(left), arrays)
    return left


def names(node: ast.AST) -> set[str]:
    """The names in an expression or a statement."""
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def _loads(statements: Sequence[ast.stmt]) -> Counter[str]:
    """Count how often each name is read."""
    nodes = (n for statement in statements for n in ast.walk(statement))
    return Counter(n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load))


def _read(statements: Sequence[ast.stmt]) -> set[str]:
    """The names that are read for more than to compute their own next value."""
    updates: Counter[str] = Counter()
    for n in (n for statement in statements for n in ast.walk(statement)):
        match n:
            case ast.Assign(targets=[ast.Name(id=key)], value=value):
                updates[key] += sum(isinstance(m, ast.Name) and m.id == key for m in ast.walk(value))
    loads = _loads(statements)
    return {key for key, count in loads.items() if count > updates[key]}


def _changes(node: ast.AST, arrays: set[str]) -> bool:
    return any(isinstance(n, ast.Call) and not arrays.isdisjoint(_arguments(n)) for n in ast.walk(node))


def _arguments(call: ast.Call) -> set[str]:
    return {argument.id for argument in call.args if isinstance(argument, ast.Name)}


def _without_unread(statements: Sequence[ast.stmt], read: set[str], arrays: set[str]) -> list[ast.stmt]:
    remaining: list[ast.stmt] = []
    for statement in statements:
        match statement:
            case ast.Pass():
                continue
            case ast.Assign(targets=[ast.Name(id=key)], value=ast.Name(id=same)) if key == same:
                continue
            case ast.Assign(targets=[ast.Name(id=key)], value=value) if key not in read:
                if _changes(value, arrays):
                    remaining.append(ast.Expr(value))
            case ast.If(test=test, body=body, orelse=orelse):
                first, second = (_without_unread(part, read, arrays) for part in (body, orelse))
                if first or second:
                    remaining.append(ast.If(test, first or [ast.Pass()], second))
            case ast.For(target=target, iter=steps, body=body):
                if left := _without_unread(body, read, arrays):
                    remaining.append(ast.For(target, steps, left, [], lineno=0))
            case _:
                remaining.append(statement)
    return remaining


def _merged(statements: Sequence[ast.stmt], loads: Counter[str], arrays: set[str]) -> list[ast.stmt]:
    """Insert an expression where it is read, if only the next statement reads it."""
    left: list[ast.stmt] = []
    for statement in statements:
        match statement:
            case ast.If(test=test, body=body, orelse=orelse):
                parts = (_merged(part, loads, arrays) for part in (body, orelse))
                statement = ast.If(test, *parts)
            case ast.For(target=target, iter=steps, body=body):
                statement = ast.For(target, steps, _merged(body, loads, arrays), [], lineno=0)
        while left and (both := _both(left[-1], statement, loads, arrays)) is not None:
            left.pop()
            statement = both
        left.append(statement)
    return left


def _both(first: ast.stmt, second: ast.stmt, loads: Counter[str], arrays: set[str]) -> ast.stmt | None:
    """Return one statement that does what both do, or None."""
    match first:
        case ast.Assign(targets=[ast.Name(id=key)], value=value) if not _changes(value, arrays):
            pass
        case _:
            return None
    match second:
        case ast.Assign(targets=[ast.Name(id=other)], value=after) if other == key and key not in names(after):
            return second
        case ast.Assign(value=ast.expr()) | ast.Return(value=ast.expr()):
            pass
        case _:
            return None
    # Read once, right after: else it would be computed twice, or after an array has changed.
    if loads[key] != 1 or key not in names(second) or _changes(second, arrays) or key in names_of_targets(second):
        return None
    merged = _Substitution(key, value).visit(copy.deepcopy(second))
    return merged if len(ast.unparse(ast.fix_missing_locations(merged))) <= LONGEST else None


def names_of_targets(statement: ast.stmt) -> set[str]:
    """The names in the places that a statement assigns to, their indices included."""
    return set().union(*map(names, statement.targets)) if isinstance(statement, ast.Assign) else set()


class _Substitution(ast.NodeTransformer):
    def __init__(self, key: str, value: ast.expr) -> None:
        self.key, self.value = key, value

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.value if node.id == self.key and isinstance(node.ctx, ast.Load) else node
