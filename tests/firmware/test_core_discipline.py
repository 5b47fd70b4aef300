"""The core promises a small chip no recursion, no heap, no floats, and a stack of known depth."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from gateway.emulator.native.flags import SOURCES

CORE = sorted(SOURCES.glob("core/*.c"))
_NODE = re.compile(r'node: \{ title: "(?P<name>[^"]+)" label: "[^"]*?(?P<bytes>\d+) bytes \((?P<kind>[^)]+)\)')
_EDGE = re.compile(r'edge: \{ sourcename: "(?P<caller>[^"]+)" targetname: "(?P<callee>[^"]+)"')


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, int], dict[str, set[str]], Path]:
    """Bytes of stack by function, callees by function, and where the object files are; by gcc, for this machine."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("the call graph is gcc's, and gcc is not installed")
    folder = tmp_path_factory.mktemp("graph")
    command = [gcc, "-std=c99", "-O1", "-fno-inline", "-fcallgraph-info=su", "-c", *map(str, CORE)]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if "fcallgraph-info" in process.stderr:
        pytest.skip("this gcc has no -fcallgraph-info")
    assert process.returncode == 0, process.stderr
    stack: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for path in folder.glob("*.ci"):
        text = path.read_text(encoding="utf-8")
        for node in _NODE.finditer(text):
            assert node["kind"] == "static", node.group(0)  # no array of a length that is only known when it runs
            stack[node["name"]] = int(node["bytes"])
        for edge in _EDGE.finditer(text):
            calls.setdefault(edge["caller"], set()).add(edge["callee"])
    return stack, calls, folder


def test_no_function_calls_itself_by_any_way(graph: tuple[dict[str, int], dict[str, set[str]], Path]) -> None:
    stack, calls, _ = graph

    assert len(stack) > 60
    assert {"b51_board_boot", "b51_board_poll", "b51_board_late", "b51_capture_interrupt"} <= stack.keys()
    for name in stack:
        reached: set[str] = set()
        todo = list(calls.get(name, ()))
        while todo:
            callee = todo.pop()
            if callee not in reached:
                reached.add(callee)
                todo += calls.get(callee, ())
        assert name not in reached


def test_the_stack_is_shallow(graph: tuple[dict[str, int], dict[str, set[str]], Path]) -> None:
    stack, calls, _ = graph

    @cache
    def depth(name: str) -> int:
        return stack.get(name, 0) + max(map(depth, calls.get(name, ())), default=0)

    # On a 64-bit machine, where a return address and each saved register are 8 bytes; the hardware's own comes on top.
    assert depth("b51_capture_interrupt") <= 64
    assert depth("b51_board_poll") <= 640


def test_nothing_is_called_but_the_core_the_hardware_and_two_functions_on_memory(
    graph: tuple[dict[str, int], dict[str, set[str]], Path],
) -> None:
    stack, calls, _ = graph

    outside = set().union(*calls.values()) - stack.keys()

    assert {name for name in outside if not name.startswith("b51_hal_")} <= {"memcpy", "memset"}
    assert len({name for name in outside if name.startswith("b51_hal_")}) == 22


@pytest.mark.parametrize("path", [*CORE, *sorted(SOURCES.glob("core/*.h"))], ids=lambda path: path.name)
def test_no_floats_and_no_heap_are_mentioned(path: Path) -> None:
    code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)

    assert not re.search(r"\b(float|double|malloc|calloc|realloc|free|alloca|goto)\b", code)
