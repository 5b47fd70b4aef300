"""Validates the content of a file against a plain dataclass with pydantic, with error messages in one line.

The dataclass defines the format: its fields are the keys, their types and `Field(ge=..., le=..., description=...)`
the allowed values.  Only external data is checked; dataclasses created by the program are not.

Rule 1: an error names file, key and value, and says what to write instead.  Only the first error is reported.
Rule 2: an unknown key is an error: ignoring a misspelt key would change results silently.
Rule 3: the only conversion is from whole numbers to numbers: no text becomes a number, no number a truth value.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from pydantic import AfterValidator, AllowInfNan, ConfigDict, Field, Strict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from protocol.errors import ConfigError, DataError, UsageError, quoted

Number = Annotated[float, Strict(), AllowInfNan(False)]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
KEYS = ConfigDict(extra="forbid")  # as __pydantic_config__ of a dataclass: unknown keys are refused

_WORDS = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text"}
_UNKNOWN = "unexpected_keyword_argument"
_adapter = cache(TypeAdapter[Any])  # making it takes twice as long as the check of a model file


class Keys:
    """The base of a dataclass whose fields are all the keys of a table: an unknown key is refused."""

    __slots__ = ()
    __pydantic_config__ = KEYS


class RuleError(ValueError):
    """Error of a validator; `problem` continues the path of the key: " = 0 makes every value equal"."""

    def __init__(self, problem: str, *, remedy: str, key: str = "") -> None:
        super().__init__(problem)
        self.problem = f".{key}{problem}" if key else problem
        self.remedy = remedy


def key(description: str, low: float | None = None, high: float | None = None) -> Any:
    """Return the annotation of a key: its description with unit, and its bounds."""
    return Field(description=description, ge=low, le=high)


def rule(check: Callable[[Any], Any]) -> AfterValidator:
    """Return a check that raises a `Board51Error` as a pydantic validator."""

    def run(value: object) -> object:
        try:
            return check(value)
        except UsageError as error:
            raise RuleError(error.problem, remedy=error.remedy) from None

    return AfterValidator(run)


def needs(*names: str) -> Callable[[object], object]:
    """Return a check for a BeforeValidator: a file must have these keys although the dataclass has defaults."""

    def check(table: object) -> object:
        absent = [name for name in names if name not in table] if isinstance(table, dict) else []
        if absent:
            raise RuleError(" is missing", remedy="Add it", key=absent[0])
        return table

    return check


def checked(
    kind: Any,
    data: object,
    *,
    where: str,
    error: type[ConfigError] | type[DataError] = ConfigError,
    from_text: bool = False,
    remedy: str = "",
    quote: Callable[[object], str] = quoted,
) -> Any:
    """Validate data that was parsed from TOML or JSON, and return it as `kind`.

    Args:
        kind: A dataclass, or an annotated type.
        data: Tables, lists, numbers and texts.
        where: File, variable or flag, for the error.
        error: Class of the error to raise.
        from_text: `data` is a text that may stand for a number, such as the value of an environment variable.
        remedy: What to do about any error, for a file that a program wrote; empty: what to write at the key.
        quote: How the error shows a value; a file with passwords shows none.

    Raises:
        ConfigError, DataError: a value is invalid; the message names place, key and value, and the allowed values.
    """
    adapter = _adapter(kind)
    try:
        return adapter.validate_strings(data) if from_text else adapter.validate_python(data)
    except ValidationError as failed:
        errors = failed.errors(include_url=False)
    problem, correction = _explain(kind, data, errors, toml=error is ConfigError, quote=quote)
    raise error(f"{where}{': ' if problem[0].isalnum() else ''}{problem}", remedy=remedy or correction)


def keys_of(kind: Any) -> dict[str, Any]:
    """Return the annotated type of each key of a dataclass, or of a mapping with named keys."""
    plain = plain_of(kind)
    if is_dataclass(plain):
        hints = get_type_hints(plain, include_extras=True)
        return {FieldInfo.from_annotation(hints[f.name]).alias or f.name: hints[f.name] for f in fields(plain)}
    options = get_args(plain)
    return dict.fromkeys(get_args(options[0]), options[1]) if len(options) == 2 else {}


def plain_of(kind: Any) -> Any:
    """Return the type without its annotations and without "or None"."""
    plain = FieldInfo.from_annotation(kind).annotation
    return plain_of(get_args(plain)[0]) if type(None) in get_args(plain) else plain


def bounds(kind: Any) -> tuple[float | None, float | None]:
    """Return the bounds (lowest, highest) of an annotated type."""
    ends: dict[str, float] = {}
    for constraint in FieldInfo.from_annotation(kind).metadata:
        ends |= {end: getattr(constraint, end) for end in ("ge", "le") if hasattr(constraint, end)}
    return ends.get("ge"), ends.get("le")


def _explain(
    kind: Any, data: object, errors: list[ErrorDetails], *, toml: bool, quote: Callable[[object], str]
) -> tuple[str, str]:
    """Return (problem, remedy) of the first error."""
    first, hint, keys, value, path = errors[0], kind, {}, data, ""
    mistake, location = first["type"], first["loc"]
    if mistake == "missing" and isinstance(location[-1], int):  # of four numbers: the list is wrong
        mistake, location = "too_short", location[:-1]
    if location and location[-1] == "[key]":  # pydantic's word for the key itself; a file may have one of that name
        mistake, location = _UNKNOWN, location[:-1]
    for step in location:
        value, inner = _item(value, step), get_args(plain_of(hint))
        if isinstance(step, int):
            label = _item(value, "file") or _item(value, "name")
            path += f" {step + 1}" + (f" ({label})" if isinstance(label, str) else "")
            hint = inner[0]
        else:
            path += f".{step}" if path else step
            keys = keys_of(hint)
            hint = keys.get(step) or (inner or (str,))[-1]
    name, expected, description = path.rpartition(".")[2], _expected(hint), FieldInfo.from_annotation(hint).description
    if mistake == "value_error":
        objection = first["ctx"]["error"]
        return f"{path}{objection.problem}".removeprefix("."), objection.remedy
    if mistake == _UNKNOWN:
        return f"{path} = {quote(value)} is not a key", _nearest(name, list(keys))
    add = (
        {"a table": f"Add [{path}]", "a list of tables": f"Add at least one [[{name}]]"}.get(expected)
        if path and toml
        else None
    )
    if mistake == "missing":
        unknown_keys = [
            str(error["loc"][-1])
            for error in errors
            if error["type"] == _UNKNOWN and error["loc"][:-1] == location[:-1]
        ]
        hints = [
            f"{other} is not a key; its unit is the end of {name}"
            for other in unknown_keys
            if _stem(other) == _stem(name)
        ]
        return f"{path} is missing ({description or expected})", (*hints, add or f"Add {name}")[0]
    problem, range_ = f"{path} = {quote(value if location else first['input'])} is not", _range(hint)
    remedy = f"Give {range_ or expected}" + (f": {description}" if description else "")
    if mistake in ("greater_than_equal", "less_than_equal"):
        return f"{problem} {'in ' * ('..' in range_)}{range_}", f"{remedy}; check the unit and the power of ten"
    return f"{problem} {expected}", "Choose one of them" if "|" in expected else add or remedy


def _item(value: object, step: str | int) -> object:
    try:
        return value[step]  # type: ignore[index]  # only tables and lists have items
    except (TypeError, LookupError):
        return None


def _expected(hint: Any) -> str:
    plain = plain_of(hint)
    if plain in _WORDS:
        return _WORDS[plain]
    options = get_args(plain)
    if options and isinstance(options[0], str):
        return f"one of {' | '.join(options)}"
    if get_origin(plain) not in (tuple, list):
        return "a table"
    item = _expected(options[0])
    items = {"text": "texts", "a table": "tables"}.get(item, "lists" if item.startswith("a list") else "numbers")
    min_length = max(
        (getattr(constraint, "min_length", 0) for constraint in FieldInfo.from_annotation(hint).metadata), default=0
    )
    count = f"{len(options)} " if len(options) > 1 and Ellipsis not in options else ""
    return f"a list of {f'at least {min_length} ' if min_length > 1 else count}{items}"


def _range(hint: Any) -> str:
    low, high = (end if isinstance(end, int | None) else f"{end:g}" for end in bounds(hint))
    return "" if low is None else f"at least {low}" if high is None else f"{low} .. {high}" if low != high else f"{low}"


def _nearest(key: str, keys: list[str]) -> str:
    matches = difflib.get_close_matches(key, keys, 1) or [other for other in keys if _stem(other) == _stem(key)]
    return f"Did you mean {matches[0]}" if matches else f"Remove it; the keys are {', '.join(keys)}"


def _stem(key: str) -> str:
    return key.split("_")[0]
