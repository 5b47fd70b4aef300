"""A cause is one file and one line of the catalogue: what others must know of it they ask its fields."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.harness.sources import trees
from twin.model.causes.catalogue import BY_NAME, CATALOGUE

pytestmark = pytest.mark.xdist_group("sources")  # parsed once
CAUSES = "twin/model/causes"
# The equations of motion and the filters along them call the causes' kernels.
PHYSICS = ("twin/model/", "twin/estimation/", "twin/mirror/observer.py")
NAMED = re.compile(rf"\b({'|'.join(map(re.escape, BY_NAME))})\b")
# A reason for which a twin starts anew; it is on the bus, and has nothing to do with the cause of that name.
ALLOWED = {(f"twin/mirror/{file}.py", "lost-samples") for file in ("mirror", "sample")}


def sources() -> Iterator[tuple[str, ast.Module]]:
    return ((path, tree) for path, tree in trees("twin") if not path.startswith(CAUSES))


def strings(tree: ast.Module) -> Iterator[str]:
    """Every string that is not a docstring."""
    prose = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.value


def test_no_file_outside_the_catalogue_names_a_cause() -> None:
    mentions = {(name, cause) for name, tree in sources() for text in strings(tree) for cause in NAMED.findall(text)}

    assert mentions - ALLOWED == set()


def test_only_the_physics_imports_the_file_of_a_cause() -> None:
    modules = {f"twin.model.causes.{cause.name.replace('-', '_')}" for cause in CATALOGUE}
    imports = {
        (name, module)
        for name, tree in sources()
        if not name.startswith(PHYSICS)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for module in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        if module in modules
    }

    assert imports == set()


def test_causes_that_name_others_name_ones_that_are_there_and_each_pair_once() -> None:
    pairs = [frozenset((cause.name, other)) for cause in CATALOGUE for other in cause.deciding_measurements]

    assert all(len(pair) == 2 and pair <= set(BY_NAME) for pair in pairs)
    assert len(pairs) == len(set(pairs))
    assert all(cause.same_samples_as in BY_NAME for cause in CATALOGUE if cause.same_samples_as)


def test_a_cause_adds_a_current_at_rest_where_points_of_rest_can_show_it() -> None:
    assert {cause.name for cause in CATALOGUE if cause.added_a} == {
        cause.name for cause in CATALOGUE if cause.at_rest == "amplifier"
    }


def test_the_kernels_of_a_cause_become_part_of_the_step() -> None:
    """As calls they made it three times as long."""
    decorators = {
        (path, decorator.id)
        for path, tree in trees(CAUSES)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for decorator in node.decorator_list
        if isinstance(decorator, ast.Name)
    }

    assert (f"{CAUSES}/core_saturation.py", "inlined") in decorators
    assert {name for name, decorator in decorators if decorator == "kernel"} == set()
