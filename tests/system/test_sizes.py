"""Classes, functions and lists of parameters that a reader takes in at once."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
MAX_CLASS_LINES, MAX_FUNCTION_LINES, MAX_PARAMETERS = 250, 60, 7
Function = ast.FunctionDef | ast.AsyncFunctionDef

# A kernel is one loop over numbers, and its calls cannot pass an object: it may be longer, and take more.
KERNELS = frozenset(["kernel", "inlined", "_compiled"])  # decorators

MANY_PARAMETERS = {
    "gateway/client/commands.py excite": "the numbers of a signal, by keyword",
    "gateway/client/rig.py excite": "the numbers of a signal, by keyword",
    "gateway/testing.py __call__": "the options of a fixture, by keyword: what a test does not name keeps its default",
    "twin/api/functions.py diagnose": "the options of `board51 diagnose`, by keyword",
    "twin/api/functions.py design": "the options of `board51 design`, by keyword",
}


def definitions() -> Iterator[tuple[str, Function | ast.ClassDef]]:
    """Yield each class and each function of the product, with its file and name."""
    packages = ("protocol", "gateway", "twin", "firmware")
    paths = [path for package in packages for path in (ROOT / package).rglob("*.py") if "_pb2" not in path.name]
    for path in sorted([*paths, ROOT / "board51.py"]):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, Function | ast.ClassDef):
                yield f"{path.relative_to(ROOT)} {node.name}", node


def functions() -> Iterator[tuple[str, Function]]:
    """Yield each function that is no kernel."""
    for name, node in definitions():
        if isinstance(node, Function) and KERNELS.isdisjoint(map(ast.unparse, node.decorator_list)):
            yield name, node


def length(node: Function | ast.ClassDef) -> int:
    """Return the number of lines, with the docstring and without the decorators."""
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def parameters(node: Function) -> int:
    """Return the number of parameters, without `self`."""
    names = [arg.arg for arg in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def test_a_class_is_read_at_once() -> None:
    classes = [(name, node) for name, node in definitions() if isinstance(node, ast.ClassDef)]

    assert [f"{name}: {length(node)} lines" for name, node in classes if length(node) > MAX_CLASS_LINES] == []


def test_a_function_is_read_at_once() -> None:
    assert [f"{name}: {length(node)} lines" for name, node in functions() if length(node) > MAX_FUNCTION_LINES] == []


def test_a_function_takes_few_parameters() -> None:
    assert {name for name, node in functions() if parameters(node) > MAX_PARAMETERS} == set(MANY_PARAMETERS)
