"""Classes, functions and lists of parameters that a reader takes in at once, and files of tests."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache

import pytest

from tests.harness.sources import ROOT, parsed, trees

pytestmark = pytest.mark.xdist_group("sources")  # parsed once
MAX_CLASS_LINES, MAX_FUNCTION_LINES, MAX_PARAMETERS = 250, 60, 7
MAX_TEST_FILE_LINES = 400
Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef

# A kernel is one loop over numbers, and its calls cannot pass an object: it may be longer, and take more.
KERNELS = frozenset(["kernel", "inlined", "_compiled"])  # decorators

MANY_PARAMETERS = {
    "gateway/client/commands.py excite": "the numbers of a signal, by keyword",
    "gateway/client/rig.py excite": "the numbers of a signal, by keyword",
    "gateway/testing.py __call__": "the options of a fixture, by keyword: what a test does not name keeps its default",
    "twin/api/functions.py diagnose": "the options of `board51 diagnose`, by keyword",
    "twin/api/functions.py design": "the options of `board51 design`, by keyword",
}


@cache
def definitions() -> list[tuple[str, Definition]]:
    """Return each class and each function of the product, with its file and name."""
    files = [file for package in ("protocol", "gateway", "twin", "firmware") for file in trees(package)]
    files.append(("board51.py", parsed(ROOT / "board51.py")))
    return [
        (f"{path} {node.name}", node) for path, tree in files for node in ast.walk(tree) if isinstance(node, Definition)
    ]


def functions() -> Iterator[tuple[str, Function]]:
    """Yield each function that is no kernel."""
    for name, node in definitions():
        if isinstance(node, Function) and KERNELS.isdisjoint(map(ast.unparse, node.decorator_list)):
            yield name, node


def length(node: Definition) -> int:
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


def test_a_file_of_tests_is_read_at_once() -> None:
    """Its name says what it tests; what files share is in `tests/harness` or a conftest."""
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")}

    assert [f"{path.relative_to(ROOT)}: {n} lines" for path, n in lines.items() if n > MAX_TEST_FILE_LINES] == []
