"""The exception tree: one class for each decision a caller can take.

    Board51Error            everything raised on purpose; says what to do next
    ├── UsageError          the caller asked for something impossible  (exit code 2)
    │   ├── ConfigError     a configuration file or key
    │   └── DataError       a recording, a table, a model file
    └── ServiceError        the outside world said no: port, bus, disk  (exit code 1)

Expected outcomes of an exchange (a time-out, a bad frame, a nack) are values, not exceptions.
"""

from __future__ import annotations


class Board51Error(Exception):
    """Every error raised on purpose: what is wrong, then what to do.

    Args:
        problem: What is wrong and where, with the offending value; no full stop.
        remedy: The next step, as an instruction; no full stop.
    """

    exit_code = 1

    def __init__(self, problem: str, *, remedy: str) -> None:
        super().__init__(f"{problem}. {remedy}.")
        self.problem = problem
        self.remedy = remedy


class UsageError(Board51Error):
    """The request cannot be carried out as it was put."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration key is missing, unknown, of the wrong type or out of bounds."""


class DataError(UsageError):
    """A file that should hold data, a log or a model does not."""


class ServiceError(Board51Error):
    """A port, the bus, the disk or another process refused."""
