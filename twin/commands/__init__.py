"""The twin's sub-commands of `board51`; each has `configure` and `run`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.viewer import open_viewer

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def progress_printer(*, quiet: bool) -> Callable[[str], None]:
    """Return a function that prints lines of progress to stderr, with the time since this call; none if `quiet`."""
    began = time.monotonic()

    def progress(line: str) -> None:
        if not quiet:
            print(f"[{time.monotonic() - began:5.1f} s] {line}", file=sys.stderr, flush=True)

    return progress


def add_show(parser: argparse.ArgumentParser) -> None:
    """Add `--show`."""
    parser.add_argument("--show", action="store_true", help="open the picture or report in the viewer of the system")


def show(path: Path) -> None:
    """Open a picture or report; without a screen, print its path."""
    if not open_viewer(path.resolve().as_uri()):
        print(f"no screen to show it: see {path}", file=sys.stderr)


def show_text(path: Path, title: str, text: str, *, figures: Sequence[Figure] = ()) -> None:
    """Write a page for a result without a report, and show it.

    Raises:
        UsageError: the page cannot be written.
    """
    from twin.api.results import write_text
    from twin.page.figures import inline
    from twin.page.render import render

    pictures = [inline(figure, title, "png") for figure in figures]
    answer, _, rest = text.partition("\n")
    page = render("page/text.html", title=title, answer=answer, colour="", text=rest.strip("\n"), pictures=pictures)
    write_text(path, page)
    show(path)
