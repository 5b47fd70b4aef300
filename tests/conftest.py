"""The settings of all tests.  Hypothesis takes the same examples on every run, with no deadline that a busy machine
could miss.  The programs that tests start hear SIGHUP and SIGINT, even if this run itself was told to ignore them
(nohup, &).

What is slow to make is made once, not in each process of the run: fixtures of a module, and machine code.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from _pytest.assertion import rewrite
from hypothesis import settings

from tests.examples import QUICK
from tests.harness.posix import needs_posix

# Before numpy is imported, here and in what tests start.  Several processes share the cores: threads of the linear
# algebra library would wait for each other by spinning, a fifth of the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# All cores are busy: a job that gives way would take ten times as long, and the rig beside it would fly on meanwhile.
os.environ.setdefault("BOARD51_CHILD_NICE", "0")
settings.register_profile("board51", derandomize=True, deadline=None, database=None)
settings.load_profile("board51")
if os.name == "posix":
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _same_priority() -> Iterator[None]:
    """A command that gives way to others, run in this process, would slow all tests behind it, for good."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "nice", lambda _increment: 0, raising=False)  # Windows has none
        yield


def pytest_configure(config: pytest.Config) -> None:
    if "not slow" in config.option.markexpr:
        os.environ[QUICK] = "1"
    if hasattr(config, "workerinput"):
        _lock_compilation()
        _share_rewriting(config)


def _share_rewriting(config: pytest.Config) -> None:
    """Rewrite the assertions of a part of the files: in a new clone each process of the run would rewrite them all."""
    worker: dict[str, Any] = vars(config)["workerinput"]
    number, count = int(worker["workerid"].removeprefix("gw")), worker["workercount"]
    for file in sorted(Path(__file__).parent.rglob("test_*.py"))[number::count]:
        bytecode = rewrite.get_cache_dir(file) / f"{file.stem}{rewrite.PYC_TAIL}"
        if not sys.dont_write_bytecode and rewrite._read_pyc(file, bytecode) is None:
            status, code = rewrite._rewrite_test(file, config)
            bytecode.parent.mkdir(parents=True, exist_ok=True)
            rewrite._write_pyc(config.stash[rewrite.assertstate_key], code, status, bytecode)


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out, on Windows, each file that could not even be imported there."""
    return True if os.name != "posix" and collection_path.suffix == ".py" and needs_posix(collection_path) else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without the garbage collector: nearly all that imports and collection make stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # xdist reads the groups in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests that need POSIX, and put the slow ones first, of all folders in turn.

    Tests that share a fixture or a cached function of their module run in one process: four would make it four times.
    """
    for item in items:
        if needs_posix(item.path):
            item.add_marker(pytest.mark.posix)
    if not hasattr(config, "workerinput"):
        return
    for item in items:
        if isinstance(item, pytest.Function) and not any(item.iter_markers("xdist_group")):
            made = item._fixtureinfo.name2fixturedefs.values()
            if any(definition[-1].scope == "module" for definition in made) or _remembers(item.module):
                item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    # The short ones fill up the end of a run, where a process would otherwise wait for the last long test.  A group
    # keeps its order: its fixtures are made once.
    slow = {_group(item) for item in items if any(item.iter_markers("slow"))}
    folders: dict[str, dict[str, None]] = {}
    for item in items:
        if _group(item) in slow:
            folders.setdefault(item.path.relative_to(Path(__file__).parent).parts[0], {})[_group(item)] = None
    # The folders take turns.  A running rig costs processor time as long as it runs: four at once, each with a browser,
    # wait for each other, while those of the twin only compute.
    turn = {group: n / len(groups) for groups in folders.values() for n, group in enumerate(groups)}
    items.sort(key=lambda item: turn.get(_group(item), 1.0))


@cache
def _remembers(module: ModuleType) -> bool:
    """Return whether the module has a function that keeps what it has made."""
    members = (value for value in vars(module).values() if getattr(value, "__module__", "") == module.__name__)
    return any(hasattr(value, "cache_clear") for value in members)


def _group(item: pytest.Item) -> str:
    marker = item.get_closest_marker("xdist_group")
    return str(marker.args[0]) if marker else item.nodeid


def pytest_collection_finish(session: pytest.Session) -> None:
    """Fail where the scheduler does not see the groups.

    xdist writes them into the ids of the tests and spreads what has no group there.  That would be silent: each
    process would make the same fixtures, for twice the time of a run.
    """
    if getattr(session.config.option, "loadgroup", False):  # in a process of the run
        lost = [
            item.nodeid for item in session.items if any(item.iter_markers("xdist_group")) and "@" not in item.nodeid
        ]
        if lost:
            text = (
                f"pytest {pytest.__version__} and pytest-xdist do not group tests: {lost[0]} and {len(lost) - 1} more"
            )
            raise pytest.UsageError(text)
    # What was imported and collected stays until the end: the garbage collector need not look through it in each test.
    gc.collect()
    gc.freeze()
    # After 50 000 new objects, not 700: a server of OPC UA starts in two thirds of the time.
    gc.set_threshold(50_000, 20, 50)


def _lock_compilation() -> None:
    """Let one process of a run compile a kernel; the others wait and read it from numba's cache on disk."""
    if sys.platform == "win32":  # each compiles for itself there
        return
    import fcntl

    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    dispatcher: Any = Dispatcher
    compiled, depth = dispatcher.compile, 0

    def compile_locked(self: Any, signature: Any) -> Any:
        nonlocal depth
        # numba's lock first: one thread of a process waits, and a kernel compiles those that it calls.
        with global_compiler_lock, Path(__file__).open() as lock:
            if not depth:
                fcntl.flock(lock, fcntl.LOCK_EX)  # closing the file lets it go
            depth += 1
            try:
                return compiled(self, signature)
            finally:
                depth -= 1

    dispatcher.compile = compile_locked
