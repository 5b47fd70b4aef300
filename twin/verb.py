"""A package that can be called: `from twin import identify` is the package `twin.identify`, and `identify(...)` works.

The public functions have the names of the packages that do the work.  Python binds a package to its name in `twin` at
its first import, wherever that happens.  A function of that name would vanish, so the package itself has to answer.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any


class Verb(ModuleType):
    """The class of such a package; calls the function of its name in `twin.api`."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Call the function."""
        return self.function(*args, **options)

    @property
    def function(self) -> Callable[..., Any]:
        """Return the function that a call runs."""
        function: Callable[..., Any] = getattr(importlib.import_module("twin.api"), self.__name__.rpartition(".")[2])
        return function

    @property
    def __signature__(self) -> inspect.Signature:
        """Return the function's signature, for help and editors."""
        return inspect.signature(self.function)
