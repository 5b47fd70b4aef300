"""Numbers of the command line, refused in words of the user and not in names of Python."""

from __future__ import annotations

from argparse import ArgumentTypeError


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
