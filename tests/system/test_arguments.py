"""Errors of arguments: one line each, in words of the user, for every argument of every command."""

from __future__ import annotations

import argparse
import importlib
import re
from collections.abc import Iterator

import pytest

import board51
from protocol.arguments import Parser

BAD = ("no-such", "\x01")  # the second for arguments that take any text that can be printed
PYTHON = re.compile(r"[<>]|\b_\w|\b(?:float|int|str|lambda|function|object|None|Path)\b")
Argument = tuple[argparse.ArgumentParser, argparse.Action]


def arguments(parser: argparse.ArgumentParser) -> Iterator[Argument]:
    """All that may refuse a value, of sub-commands too."""
    for action in parser._actions:
        if isinstance(action.choices, dict):  # the sub-commands
            for inner in action.choices.values():
                yield from arguments(inner)
        if action.type is not None or action.choices is not None:
            yield parser, action


def refusals(parser: argparse.ArgumentParser, action: argparse.Action) -> Iterator[str]:
    for value in BAD:
        try:
            parser._check_value(action, parser._get_value(action, value))
        except argparse.ArgumentError as error:
            yield str(error)


def of_command(name: str) -> list[Argument]:
    parser = Parser(prog=f"board51 {name}")
    importlib.import_module(board51.COMMANDS[name][0]).configure(parser)
    return list(arguments(parser))


@pytest.mark.parametrize("name", sorted(board51.COMMANDS))
def test_no_refusal_of_an_argument_has_a_name_of_python(name: str) -> None:
    messages = [text for parser, action in of_command(name) for text in refusals(parser, action)]

    assert not [text for text in messages if PYTHON.search(text)]


def test_the_walk_reaches_sub_commands_and_all_kinds_of_refusals() -> None:
    messages = [text for name in ("send", "campaign") for argument in of_command(name) for text in refusals(*argument)]

    assert "argument mode: invalid choice: 'no-such'" in " ".join(messages)
    assert "argument --timeout: 'no-such' is not a number" in messages
    assert "argument --seed: 'no-such' is not a whole number" in messages
    assert r"argument --id: '\x01' has characters that cannot be printed" in messages


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("idenify", "board51: there is no command 'idenify' (did you mean identify?)."),
        ("--versoin", "board51: there is no option --versoin (did you mean --version?)."),
        ("send rig1 referense 3", "(did you mean reference?)"),
        ("send rig1 excite step --ampltude=1", "there is no option --ampltude (did you mean --amplitude?)"),
        ("validate runs --modle m --out d", "there is no option --modle (did you mean --model?)"),
        ("send rig1 reference 3", "3 m is more than any such rig has. You may mean 0.003 (3 mm)."),
        ("design ce152 --operating-point 3", "You may mean 0.003 (3 mm)"),
        ("watch --qqq", "there is no option --qqq. "),
        ("design --model m", "there is no option --model. "),
        ("watch rig1", "'rig1' is one argument too many"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_one(
    line: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        board51.main(line.split())

    assert expected in capsys.readouterr().err


def test_help_can_be_asked_for_as_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        board51.main(["help", "watch"])

    assert "board51 watch --topic" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ["bogus"],
        ["send", "rig1", "mode", "none"],
        ["send"],
        ["watch", "--every", "x"],
        ["start"],
        *(["fill", ".", f"--every={text}"] for text in ("0", "-1", "nan", "inf")),
        ["logs", "archive", ".", "--to", "s3://a", "--every=nan"],
    ],
    ids=" ".join,
)
def test_a_wrong_word_is_one_line_that_names_the_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        board51.main(words)

    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count("\n")) == (2, "", 1)
    assert re.match(r"board51.*: .+\. `board51.* --help` explains\.\n", err)
