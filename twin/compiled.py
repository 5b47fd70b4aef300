"""`kernel`: numba's njit where numba is at hand, the plain Python function where it is not.

Rule 1: a kernel is readable scalar Python that gives the same numbers uncompiled (NUMBA_DISABLE_JIT=1 does that too:
        tests/twin/test_simulate.py uses it as the oracle of the compiled code).
Rule 2: a kernel called once per sample takes its constants as a plain `Packed` tuple and names them inside: numba
        reads a NamedTuple field by field through its names, 1.2 us a call, a plain tuple in 0.2 us.
Rule 3: a division by zero gives inf, as in numpy: testing each divisor for it makes a kernel up to six times as slow.
Rule 4: never `fastmath`.  A replayed log must give the bits of the live run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeAlias, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")
Packed: TypeAlias = tuple[Any, ...]  # tuple(of a NamedTuple of numbers)


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call and keep the machine code on disk where that is possible."""
    try:
        import numba
    except ImportError:
        return function
    try:
        return cast(Callable[P, R], numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:
        # A read-only installation (a container's) without a home directory has no place for numba's cache.
        return cast(Callable[P, R], numba.njit(nogil=True, error_model="numpy")(function))
