"""The exceptions of Board51: one class for each way in which a caller can react.

    Board51Error            everything raised on purpose; says what to do next
    ├── UsageError          the caller asked for something impossible  (exit code 2)
    │   ├── ConfigError     a configuration file or key
    │   ├── DataError       a recording, a table, a model file
    │   └── InstallError    a part that is not installed
    └── ServiceError        a port, the bus or the disk failed          (exit code 1)

Expected outcomes of an exchange (a time-out, a bad frame, a nack) are values, not exceptions.
"""

from __future__ import annotations

from importlib.util import find_spec

LONGEST = 1000  # characters of a problem, and of a remedy


class Board51Error(Exception):
    """The base class of all errors that are raised on purpose: what is wrong, then what to do.

    The message is a single line without control characters, whatever it quotes: see `single_line`.

    Args:
        problem: What is wrong and where, with the offending value; no full stop.
        remedy: The next step, as an instruction; no full stop.
    """

    exit_code = 1

    def __init__(self, problem: str, *, remedy: str) -> None:
        self.problem = single_line(problem)
        self.remedy = single_line(remedy)
        super().__init__(f"{self.problem}. {self.remedy}.")


class UsageError(Board51Error):
    """The request cannot be carried out as given."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration key is missing, unknown, of the wrong type or out of bounds."""


class DataError(UsageError):
    """A file does not contain the expected data, log or model."""


class InstallError(UsageError):
    """A library of an optional component is not installed."""


class ServiceError(Board51Error):
    """A port, the bus, the disk or another process failed."""


def missing_extra(extra: str, library: str) -> InstallError:
    """Return the error for a missing `library` that the extra `extra` of pyproject.toml installs."""
    return InstallError(
        f"{library} is not installed: it comes with the extra {extra!r}",
        remedy=f"pip install 'board51[{extra}]' adds it; with pipx: pipx runpip board51 install 'board51[{extra}]';"
        f" in a clone: pip install -e '.[{extra}]'",
    )


def require(extra: str, *libraries: str) -> None:
    """Check that the libraries of `extra` are installed, before long work or before starting another process.

    Raises:
        InstallError: a library is not installed.
    """
    for library in libraries:
        if find_spec(library) is None:
            raise missing_extra(extra, library)


def single_line(text: str, longest: int = LONGEST) -> str:
    """Return `text` with line breaks and control characters escaped, and its middle removed if it is long.

    Errors quote files and bus messages: the quoted text must not control the terminal or hide the rest of the message.
    """
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    half = (longest - 5) // 2
    return escaped if len(escaped) <= longest else f"{escaped[:half]} ... {escaped[-half:]}"


def quoted(value: object) -> str:
    """Return a value for an error message, shortened to 80 characters."""
    return single_line(repr(value), 80)
