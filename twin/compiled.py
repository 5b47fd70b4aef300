"""`kernel`: numba's njit where numba is at hand, the plain Python function where it is not.

Rule 1: a kernel is readable scalar Python that gives the same numbers uncompiled.  With NUMBA_DISABLE_JIT=1 nothing is
        compiled: tests/harness/twin/plain_python.py uses that as the oracle of the compiled code.
Rule 2: a kernel called once per sample takes its constants as a plain `Packed` tuple and names them inside.  numba
        reads a NamedTuple field by field through its names, 1.2 us a call; a plain tuple takes 0.2 us.
Rule 3: a division by zero gives inf, as in numpy: testing each divisor for it makes a kernel up to six times as slow.
Rule 4: never `fastmath`.  A replayed log must give the bits of the live run.
Rule 5: machine code on disk is kept under a hash of all files with kernels.  numba looks at a kernel's own file only:
        changed code in another file that it calls would go on running as it was.  The emulator, which shares nothing
        with the twin, has a cache of its own.
Rule 6: a loop over samples takes no slice of an array, and passes none to a kernel that is not inlined.  Each would
        count a reference with an atomic instruction; these were a seventh of a run that reuses its steps.  Pass the
        array with the index of the sample to an inlined function, and numbers to others.  Fields of a record are free.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")
Packed: TypeAlias = tuple[Any, ...]  # tuple(of a NamedTuple of numbers)
_IN_MACHINE_CODE = b"@kernel", b"@inlined", b"(NamedTuple)"
OLD_S = 7 * 86400.0  # machine code of former sources is removed after this time without use


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call and keep the machine code on disk where that is possible."""
    return _compiled(function)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A kernel that becomes part of the kernels that call it: one whose call would cost as much as its work.

    Where it does not become part, each call passes its arrays field by field and may count a reference.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: Callable[P, R], *, forceinline: bool = False) -> Callable[P, R]:
    try:
        import numba
    except ImportError:
        return function
    compile_it: Any = partial(numba.njit, nogil=True, error_model="numpy", forceinline=forceinline)
    # numba reads CACHE_DIR while it decorates, so other packages keep their own cache folders.
    config: Any = numba.config
    default_dir, config.CACHE_DIR = config.CACHE_DIR, cache_folder()
    try:
        return cast(Callable[P, R], compile_it(cache=True)(function))
    except RuntimeError:
        # A read-only installation (a container's) without a home directory has no place for numba's cache.
        return cast(Callable[P, R], compile_it()(function))
    finally:
        config.CACHE_DIR = default_dir


def sources_hash(package: Path) -> str:
    """Hash name and content of each file below `package` with kernels or with named tuples that they take."""
    # os.walk: pathlib takes three times as long, and every start of the command waits for this.
    digest = hashlib.sha256()
    for folder, below, files in os.walk(package):
        below[:] = sorted(name for name in below if name != "__pycache__")
        for file in sorted(files):
            if file.endswith(".py"):
                path = os.path.join(folder, file)
                with open(path, "rb", buffering=0) as source:
                    data = source.read()
                if any(mark in data for mark in _IN_MACHINE_CODE):
                    digest.update(os.path.relpath(path, package).encode() + b"\0" + data)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> str:
    """Return the folder for the machine code of the current sources."""
    package = Path(__file__).parent
    name = f"kernels-{sources_hash(package)}"
    for parent in _parents(package):
        try:
            (parent / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(parent / name, os.W_OK):
            _tidy(parent, keep=name)
            return str(parent / name)
    return ""


def _parents(package: Path) -> Iterator[Path]:
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        return
    yield package / "__pycache__"
    from platformdirs import user_cache_path  # slow, and nearly never asked for

    yield user_cache_path("board51", appauthor=False)


def _tidy(parent: Path, *, keep: str) -> None:
    # Another process may be at it, too: what cannot be removed stays.
    for folder in parent.glob("kernels-*"):
        try:
            if folder.name != keep and time.time() - folder.stat().st_mtime > OLD_S:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
