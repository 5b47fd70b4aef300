"""The exception tree: one class for each decision a caller can take.

    Board51Error            everything raised on purpose; says what to do next
    ├── UsageError          the caller asked for something impossible  (exit code 2)
    │   ├── ConfigError     a configuration file or key
    │   ├── DataError       a recording, a table, a model file
    │   └── InstallError    a part that is not installed
    └── ServiceError        the outside world said no: port, bus, disk  (exit code 1)

Expected outcomes of an exchange (a time-out, a bad frame, a nack) are values, not exceptions.
"""

from __future__ import annotations

from importlib.util import find_spec

LONGEST = 1000  # characters of a problem, and of a remedy


class Board51Error(Exception):
    """Every error raised on purpose: what is wrong, then what to do.

    One line that any terminal can show, whatever was put into it: see `one_line`.

    Args:
        problem: What is wrong and where, with the offending value; no full stop.
        remedy: The next step, as an instruction; no full stop.
    """

    exit_code = 1

    def __init__(self, problem: str, *, remedy: str) -> None:
        self.problem = one_line(problem)
        self.remedy = one_line(remedy)
        super().__init__(f"{self.problem}. {self.remedy}.")


class UsageError(Board51Error):
    """The request cannot be carried out as it was put."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration key is missing, unknown, of the wrong type or out of bounds."""


class DataError(UsageError):
    """A file that should hold data, a log or a model does not."""


class InstallError(UsageError):
    """A library of an optional part is not installed."""


class ServiceError(Board51Error):
    """A port, the bus, the disk or another process refused."""


def missing_extra(extra: str, library: str) -> InstallError:
    """The error of a part whose `library` is absent: it comes with an extra of pyproject.toml."""
    return InstallError(
        f"{library} is not installed: it comes with the extra {extra!r}",
        remedy=f"In the folder with board51's source: pip install '.[{extra}]' (or pipx install --force '.[{extra}]')",
    )


def require(extra: str, *libraries: str) -> None:
    """Ask before long work, or before another process, whether the libraries of `extra` are installed.

    Raises:
        InstallError: one of them is not.
    """
    for library in libraries:
        if find_spec(library) is None:
            raise missing_extra(extra, library)


def one_line(text: str, longest: int = LONGEST) -> str:
    """`text` with line breaks and control characters spelled out, and without its middle if it is long.

    What an error quotes comes from files and from the bus: it must not act on the terminal, or hide what is beside it.
    """
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    half = (longest - 5) // 2
    return shown if len(shown) <= longest else f"{shown[:half]} ... {shown[-half:]}"


def shown(value: object) -> str:
    """A value in an error: not more of it than tells which."""
    return one_line(repr(value), 80)
