"""Numbers of the command line, refused in words of the user and not in names of Python."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


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


def argument(parse: Callable[[str], T], is_good: Callable[[T], bool], problem: str) -> Callable[[str], T]:
    """Return the type of an option: parsed with `parse`, and refused as `TEXT PROBLEM` unless it is good."""

    def checked(text: str) -> T:
        value = parse(text)
        if not is_good(value):
            raise ArgumentTypeError(f"{text} {problem}")
        return value

    return checked
