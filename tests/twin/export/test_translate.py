"""The specialiser: what it folds, what it keeps, what it refuses."""

from __future__ import annotations

import ast
import math

import pytest

from tests.harness.twin.exported import T_S, with_causes
from twin.export.rig import rig
from twin.export.translate import c, fold, matlab, modelica
from twin.export.translate.specialise import Function, Program
from twin.export.translate.tidy import tidied
from twin.export.translate.values import Cells, Code, Known, NotTranslatableError, Value, name
from twin.model.parameters import Model

A: Value = Code(name("a"), "float")
TABLE = (0.5, 2.0)


def loops_back(x: float, cells: list[float]) -> float:
    """Sum the cells backwards."""
    total = 0.0
    for k in range(9, 3, -1):
        if cells[k] < 0.0:
            total = total - x
        else:
            total += cells[k]
    return total


def swaps(a: float, b: float) -> tuple[float, float]:
    """Swap."""
    a, b = b, a
    return a, b


def looks_up(a: float) -> float:
    """Take a row."""
    return TABLE[1 if a > 0.0 else 0] * TABLE[0]


def raises(a: float) -> float:
    """Do what no kernel does."""
    with open("x"):
        return a


def specialised(function: object, *arguments: Value) -> Function:
    return Program().add(function, arguments)  # type: ignore[arg-type]  # any kernel


def ran(written: Function, *arguments: object) -> object:
    """Run a specialised function as Python."""
    names = [*written.arrays, *(key for key, _ in written.parameters)]
    text = f"def f({', '.join(names)}):\n" + "\n".join(
        f"    {line}"
        for statement in written.body
        for line in ast.unparse(ast.fix_missing_locations(statement)).splitlines()
    )
    space: dict[str, object] = {"math": math, "TABLE": TABLE}
    exec(text, space)
    result: object = space["f"](*arguments)  # type: ignore[operator]  # of an exec
    return result


def test_a_model_without_causes_has_none_in_its_code() -> None:
    text = c.functions(rig(Model.load("ce152"), T_S).program)

    assert "m->c[" not in text
    assert not any(word in text for word in ("friction", "eddy", "delay", "curve"))


def test_a_cause_brings_its_own_code_only() -> None:
    text = c.functions(rig(with_causes("coulomb-friction"), T_S).program)

    assert "coulomb_friction_brakes" in text
    assert "eddy" not in text


@pytest.mark.parametrize(
    ("op", "left", "right", "result"),
    [
        (ast.Mult(), A, Known(1.0), A),
        (ast.Mult(), Known(0.0), A, Known(0.0)),
        (ast.Add(), Known(0.0), A, A),
        (ast.Div(), A, Known(math.inf), Known(0.0)),
        (ast.Pow(), A, Known(1.0), A),
        (ast.Add(), Known(2.0), Known(3.0), Known(5.0)),
    ],
)
def test_what_does_nothing_vanishes(op: ast.operator, left: Value, right: Value, result: Value) -> None:
    assert fold.arithmetic(op, left, right) == result


def test_a_loop_with_branches_computes_the_same() -> None:
    cells = [float(n) - 6.0 for n in range(10)]

    written = specialised(loops_back, Code(name("x"), "float"), Cells(name("cells"), {}))

    assert ran(written, cells, 0.25) == loops_back(0.25, cells)


def test_a_swap_stays_a_swap() -> None:
    assert ran(specialised(swaps, A, Code(name("b"), "float")), 1.0, 2.0) == (2.0, 1.0)


def test_a_table_is_looked_up_at_run_time() -> None:
    assert [ran(specialised(looks_up, A), a) for a in (-1.0, 1.0)] == [looks_up(-1.0), looks_up(1.0)]


def test_a_known_argument_decides_a_branch() -> None:
    written = specialised(looks_up, Known(3.0))

    assert ast.unparse(written.body[0]) == "return 1.0"


def test_an_unknown_construct_is_named() -> None:
    with pytest.raises(NotTranslatableError, match=r"raises uses `with open\('x'\):`, which cannot be translated"):
        specialised(raises, A)


def test_a_call_that_changes_an_array_is_never_left_out() -> None:
    statements = ast.parse("a = step(memory)\nb = 1.0\nreturn_ = memory[0]\nmemory[1] = return_").body

    left = [ast.unparse(ast.fix_missing_locations(s)) for s in tidied(statements, {"memory"})]

    assert left == ["step(memory)", "memory[1] = memory[0]"]


def test_each_language_writes_infinity_in_its_way() -> None:
    assert [language.number(math.inf) for language in (c, matlab, modelica)] == ["INFINITY", "Inf", "1e300"]
