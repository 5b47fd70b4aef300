"""Print a script that completes commands, options and their choices in bash or zsh; other words complete as files.

The script contains the commands of this installation: make it again after an update.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterator
from contextlib import suppress

from protocol.arguments import Parser

# `way` collects the words that form a sub-command, and selects the words and options that may follow.
SCRIPT = """{head}_board51() {{
  local way="" words="" options="" i
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}"
  for ((i = 1; i < COMP_CWORD; i++)); do
    case "$way ${{COMP_WORDS[i]}}" in
      {ways}) way="$way ${{COMP_WORDS[i]}}" ;;
    esac
  done
  case "$way" in
{words}
  esac
  case "$way $before" in
{choices}
    *) [[ "$current" == -* ]] && words="$options" ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _board51 board51"""
HEADS = {"bash": "", "zsh": "autoload -Uz compinit bashcompinit\ncompinit\nbashcompinit\n"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the argument: which shell."""
    parser.epilog = (
        "examples:\n"
        "  board51 completion bash > ~/.local/share/bash-completion/completions/board51\n"
        "  echo 'eval \"$(board51 completion zsh)\"' >> ~/.zshrc    computed again in each shell, which takes a second"
    )
    parser.add_argument("shell", choices=tuple(HEADS), metavar="SHELL", help=" or ".join(HEADS))


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from board51 import COMMANDS  # its own table

    top = Parser(prog="board51")
    top.add_argument("--version", action="store_true")
    commands = top.add_subparsers()
    for name, (module, _) in COMMANDS.items():
        command = commands.add_parser(name)
        with suppress(ModuleNotFoundError):  # an extra that is not installed
            importlib.import_module(module).configure(command)
    parsers = dict(_tree(top, ""))
    words, choices = [], []
    for way, parser in parsers.items():
        follow = [str(c) for action in _actions(parser) if not action.option_strings for c in action.choices or ()]
        options = [option for action in _actions(parser) for option in action.option_strings if option[:2] == "--"]
        words.append(f'    "{way}") words="{" ".join(follow)}" options="{" ".join(options)}" ;;')
        choices += [
            f'    "{way} {option}") words="{" ".join(map(str, action.choices))}" ;;'
            for action in _actions(parser)
            for option in action.option_strings
            if action.choices is not None
        ]
    ways = "|".join(f'"{way}"' for way in parsers if way)
    script = SCRIPT.format(head=HEADS[args.shell], ways=ways, words="\n".join(words), choices="\n".join(choices))
    print(script)
    return 0


def _actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return parser._actions  # noqa: SLF001  # argparse has no public list of them


def _tree(parser: argparse.ArgumentParser, way: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield each parser with the sub-commands that lead to it, each after a space."""
    yield way, parser
    for action in _actions(parser):
        if isinstance(action.choices, dict):
            for name, inner in action.choices.items():
                yield from _tree(inner, f"{way} {name}")
