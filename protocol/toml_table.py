"""A parsed TOML table that refuses what it does not know and says where.

Rule: an error names file, key and value, and says what to write instead.  `done` refuses the keys that nobody asked
for, because a key that is ignored for a typing mistake changes results silently.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import cast

from protocol.errors import ConfigError, one_line


def is_number(value: object) -> bool:
    """Finite, and not a bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def shown(value: object) -> str:
    """A value in an error: not more of it than tells which."""
    return one_line(repr(value), 80)


class TomlTable:
    """A TOML table that knows where it stands and which of its keys were asked for."""

    def __init__(self, where: str, key: str, values: Mapping[str, object]) -> None:
        self.where = where
        self.key = key
        self.values = values
        self._known: list[str] = []

    def take(self, key: str) -> object:
        """The value as it is, None if absent."""
        self._known.append(key)
        return self.values.get(key)

    def done(self, known: Sequence[str] = ()) -> None:
        """Refuse the keys that nobody asked for."""
        keys = [*self._known, *known]
        for key in self.values:
            if key not in keys:
                stem = key.split("_")[0]
                near = difflib.get_close_matches(key, keys, 1) or [k for k in keys if k.split("_")[0] == stem]
                hint = f"Did you mean {near[0]}" if near else f"Remove it; the keys are {', '.join(keys)}"
                raise ConfigError(f"{self._name(key)} = {shown(self.values[key])} is not a key", remedy=hint)

    def text(self, key: str, *, default: str | None = None) -> str:
        """A text; not empty where it has no default."""
        value = self.take(key)
        if value is None and default is not None:
            return default
        if not isinstance(value, str) or (not value and default is None):
            raise self._wrong(key, value, "text", f'Write {key} = "..."')
        return value

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of some words."""
        value = self.take(key)
        if value not in choices:
            raise self._wrong(key, value, f"one of {' | '.join(choices)}", "Choose one of them")
        return cast(str, value)

    def number(
        self,
        key: str,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        default: float | None = None,
        meaning: str = "",
    ) -> float:
        """A finite number within bounds; `meaning` says what these are."""
        value = self.take(key)
        if value is None and default is not None:
            return default
        if not is_number(value):
            raise self._wrong(key, value, "a finite number", f"Write {key} = <number>")
        number = float(cast(float, value))
        if not low <= number <= high:
            bounds = f"in {low:g} .. {high:g}" if math.isfinite(high) else f"at least {low:g}"
            bounds += f", {meaning}" if meaning else ""
            raise self._wrong(key, value, bounds, "Check the unit: it is the end of the key")
        return number

    def numbers(self, key: str, count: int) -> list[float]:
        """So many finite numbers."""
        value = self.take(key)
        if not isinstance(value, list) or len(value) != count or not all(is_number(item) for item in value):
            raise self._wrong(key, value, f"a list of {count} numbers", "Correct the list")
        return [float(item) for item in value]

    def table(self, key: str) -> TomlTable:
        """A table inside this one."""
        value = self.take(key)
        if not isinstance(value, dict):
            raise self._wrong(key, value, "a table", f"Add [{self._path(key)}]")
        return TomlTable(self.where, self._path(key), value)

    def tables(self, key: str) -> list[TomlTable]:
        """The tables of `[[key]]`, one at least."""
        value = self.take(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self._wrong(key, value, "a list of tables", f"Add at least one [[{key}]]")
        return [TomlTable(self.where, f"{key} {number}", item) for number, item in enumerate(value, 1)]

    def _path(self, key: str) -> str:
        return f"{self.key}.{key}" if self.key else key

    def _name(self, key: str) -> str:
        return f"{self.where}: {self._path(key)}"

    def _wrong(self, key: str, value: object, expected: str, remedy: str) -> ConfigError:
        if key not in self.values:
            stem = key.split("_")[0]
            for other in self.values:
                if other.split("_")[0] == stem and other not in self._known:  # mass_g where mass_kg is meant
                    remedy = f"{other} is not a key; its unit is the end of {key}"
            return ConfigError(f"{self._name(key)} is missing: it is {expected}", remedy=remedy)
        return ConfigError(f"{self._name(key)} = {shown(value)} is not {expected}", remedy=remedy)
