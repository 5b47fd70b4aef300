"""Arguments of the command line, refused in words of the user and not in names of Python."""

from __future__ import annotations

import math
import sys
from argparse import Action, ArgumentError, ArgumentParser, ArgumentTypeError, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable
from typing import Any, NoReturn, TypeVar

from protocol import units
from protocol.errors import UsageError, single_line

T = TypeVar("T")


class Parser(ArgumentParser):
    """A parser whose errors are one line without names of Python, with the nearest word; its sub-commands inherit."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": RawDescriptionHelpFormatter} | options)
        self.register("type", float, number)
        self.register("type", int, whole_number)

    def error(self, message: str) -> NoReturn:
        """Write the usage error to stderr, and exit with 2."""
        self.exit(2, f"{self.prog}: {single_line(message)}. `{self.prog} --help` explains.\n")

    def parse_known_args(self, args: Iterable[str] | None = None, namespace: Any = None) -> Any:
        """Parse as argparse does, but refuse what is unknown, here where its own parser has the nearest option."""
        words = list(sys.argv[1:] if args is None else args)
        if self._subparsers is None:  # first: argparse would complain of a missing argument, which is only misspelt
            self._refuse_unknown(words)
        result, rest = super().parse_known_args(words, namespace)
        self._refuse_unknown(rest)
        if rest:
            self.error(f"{rest[0]!r} is one argument too many")
        return result, rest

    def _refuse_unknown(self, words: list[str]) -> None:
        known = self._option_string_actions
        for word in words[: words.index("--")] if "--" in words else words:
            option = word.partition("=")[0]
            if word.startswith("--") and " " not in word and not any(name.startswith(option) for name in known):
                self.error(f"there is no option {option}{nearest(option, known)}")

    def _check_value(self, action: Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except ArgumentError as error:
            error.message += nearest(str(value), map(str, action.choices or ()))
            raise


def nearest(word: str, words: Iterable[str]) -> str:
    """Return ` (did you mean X?)` with the most similar of `words`, or nothing if none is."""
    import difflib  # a STOP shall not wait for it

    matches = difflib.get_close_matches(word, list(words), 1, 0.7)  # at 0.6, --model is similar to --help
    return f" (did you mean {matches[0]}?)" if matches else ""


def number(text: str) -> float:
    """Return a number; raise ArgumentTypeError if `text` is none."""
    try:
        return float(text)
    except ValueError:
        raise ArgumentTypeError(f"{text!r} is not a number") from None


def whole_number(text: str) -> int:
    """Return a whole number; raise ArgumentTypeError if `text` is none."""
    try:
        return int(text)
    except ValueError:
        raise ArgumentTypeError(f"{text!r} is not a whole number") from None


def quantity(channel: str) -> Callable[[str], float]:
    """Return the type of an option that is a value of `channel` (units.py): `0.003` or `3mm`."""

    def parse(text: str) -> float:
        try:
            return units.quantity(text, channel)
        except UsageError as error:
            raise ArgumentTypeError(f"{error.problem}. {error.remedy}") from None

    return parse


def argument(parse: Callable[[str], T], is_good: Callable[[T], bool], problem: str) -> Callable[[str], T]:
    """Return the type of an option: parsed with `parse`, and refused as `TEXT PROBLEM` unless it is good."""

    def checked(text: str) -> T:
        value = parse(text)
        if not is_good(value):
            raise ArgumentTypeError(f"{text} {problem}")
        return value

    return checked


def add_repeatable(parser: ArgumentParser, option: str, metavar: str, text: str) -> None:
    """Add an option that may be given several times: a list, which is empty without it."""
    parser.add_argument(option, action="append", default=[], metavar=metavar, help=text)


interval = argument(number, lambda seconds: 0.0 < seconds < math.inf, "is no interval; give seconds above 0")
