"""Every command and option that the page advises people to type exists, in all the texts that it can show."""

from __future__ import annotations

import argparse
import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import board51
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import feed_of, played_gateway

ROOT = Path(__file__).parents[3]
# The page itself, and whoever writes what its lists show: alarms, events, replies.
ROOMS = ("views/hmi", "views/hmi/html", "views", "record", "record/tables", "link", "bus", "board", "client", "")
FOLDERS = (*(f"gateway/{room}" for room in ROOMS), "protocol/log", "twin/mirror")
OF_THE_PAGE = "gateway/views/hmi"
COMMAND = re.compile(r"\bboard51 ([a-z]+)\b([^`\n]*)")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


def texts(path: Path) -> Iterator[str]:
    """Strings of a source that are no documentation; what is put in at run time is X."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from (line for line in source.splitlines() if not line.lstrip().startswith(("//", "/*", "#")))
        return
    tree = ast.parse(source)
    documentation = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    within = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in documentation | within:
                yield node.value


def sources() -> list[Path]:
    paths = {
        path
        for folder in FOLDERS
        for kind in ("*.py", "*.toml", "static/*.js", "static/*.html")
        for path in (ROOT / folder).glob(kind)
    }
    return sorted(paths)


def options_of(command: str) -> set[str]:
    """Every option of `board51 COMMAND` and of what is below it."""
    parser = argparse.ArgumentParser()
    importlib.import_module(board51.COMMANDS[command][0]).configure(parser)
    options: set[str] = set()
    waiting = [parser]
    while waiting:
        for action in waiting.pop()._actions:
            options.update(action.option_strings)
            if isinstance(action, argparse._SubParsersAction):
                waiting.extend(action.choices.values())
    return options


def advice() -> list[tuple[str, str]]:
    """(where, text) of all that names a command."""
    return [
        (path.relative_to(ROOT).as_posix(), text) for path in sources() for text in texts(path) if COMMAND.search(text)
    ]


def test_commands_and_options_that_are_advised_exist() -> None:
    passages = advice()
    assert len([where for where, _ in passages if where.startswith(OF_THE_PAGE)]) >= 3

    for where, text in passages:
        for command, rest in COMMAND.findall(text):
            assert command in board51.COMMANDS, f"{where}: {text!r}"
            unknown = set(OPTION.findall(rest)) - options_of(command)
            assert not unknown, f"{where}: board51 {command} has no {unknown}: {text!r}"


def test_the_page_names_no_option_without_its_command() -> None:
    """Whoever reads the page does not know which command's it is, or whether that was typed at all."""
    for path in (ROOT / OF_THE_PAGE).rglob("*"):
        if (
            path.suffix not in (".py", ".toml", ".js", ".html") or path.name == "app.py"
        ):  # that one speaks to who typed its command
            continue
        for text in texts(path):
            if " " in text.strip():  # an argument list of a job is no text
                assert not OPTION.findall(COMMAND.sub("", text)), f"{path.name}: {text!r}"


def test_a_reply_to_a_view_advises_no_option() -> None:
    """A page, an OPC UA client: nobody there has typed any."""
    with played_gateway() as gateway, feed_of(gateway) as feed:
        gateway.stop_answering()
        reply = feed.command("rig", pb.Command(stop=pb.Stop()), who="ben")

    assert reply.reason == "not-delivered"
    assert not OPTION.findall(reply.text)


@pytest.mark.parametrize(
    ("text", "right"),
    [
        ("`board51 diagnose CAMPAIGN --out X`", True),
        ("`board51 gateway --reports X`", False),
        ("`board51 frob`", False),
    ],
)
def test_the_check_itself_tells_them_apart(text: str, right: bool) -> None:
    ((command, rest),) = COMMAND.findall(text)

    assert (command in board51.COMMANDS and set(OPTION.findall(rest)) <= options_of(command)) is right
