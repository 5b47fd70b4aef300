"""What MkDocs is told beyond `mkdocs.yml`: Markdown that lies beside the code it describes is a page of the site, too.

So is a script with cells (percent format): its text as text, its code as code, and the whole as a notebook of Jupyter.
A link in any page is written as it works in the repository.  To a file that is a page here it leads to that page; of
any other file of the repository the link's text stays, since the site holds no source code.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {  # page of the site: file of the repository
    "interface.md": "protocol/README.md",
    "firmware.md": "firmware/README.md",
    "magnetoshield.md": "firmware/magnetoshield.md",
    "gateway.md": "gateway/README.md",
    "views.md": "gateway/views/README.md",
    "theory/twin.md": "twin/README.md",
    "theory/identify.md": "twin/identification/README.md",
    "theory/design.md": "twin/control_design/README.md",
    "theory/validate.md": "twin/validation/README.md",
    "theory/frequency.md": "twin/frequency/README.md",
    "theory/diagnose.md": "twin/diagnosis/README.md",
    "theory/matrix.md": "twin/diagnosis/matrix.md",
    "changes.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "notebooks/first_diagnosis.md": "docs/notebooks/first_diagnosis.py",
    "notebooks/subscribe_command_replay.md": "docs/notebooks/subscribe_command_replay.py",
}
_SITE = {file: page for page, file in PAGES.items()}
_LINK = re.compile(r"\[(?P<text>[^\]\n]+(?:\n[^\]\n]+)?)\]\((?P<to>[^)\s:#]+)(?P<anchor>#[^)\s]*)?\)")
_CELL = re.compile(r"^# %%(?P<text> \[markdown\])?\n", re.MULTILINE)
_CODE = re.compile(r"^```.*?^```|`[^`\n]+`(?!\])", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not Markdown in docs/."""
    root = Path(config.config_file_path).parent
    for page, file in PAGES.items():
        if file.endswith(".py"):
            files.append(File.generated(config, page, content=page_of_cells(root / file)))
            notebook = page.replace(".md", ".ipynb")
            files.append(File.generated(config, notebook, content=notebook_of_cells(root / file)))
        else:
            files.append(File.generated(config, page, abs_src_path=str(root / file)))
    return files


def cells_of(script: Path) -> list[tuple[bool, str]]:
    """The cells of a script: whether it is text, and its content."""
    _, *cells = _CELL.split(script.read_text(encoding="utf-8"))
    return [
        (bool(is_text), re.sub(r"^# ?", "", cell.strip(), flags=re.MULTILINE) if is_text else cell.strip())
        for is_text, cell in zip(cells[::2], cells[1::2], strict=True)
    ]


def page_of_cells(script: Path) -> str:
    """Markdown of a script with cells; below its heading, notebook and script to take home."""
    page = "\n\n".join(cell if is_text else f"```python\n{cell}\n```" for is_text, cell in cells_of(script))
    heading, _, rest = page.partition("\n")
    notebook = f"{script.stem}.ipynb"
    return (
        f'{heading}\n\n<a href="{notebook}" download>Download {notebook}</a>, or the script'
        f' <a href="{script.name}" download>{script.name}</a>. To open the notebook, in the environment of board51:'
        f"\n\n```sh\npip install jupyterlab\njupyter lab {notebook}\n```\n{rest}\n"
    )


def notebook_of_cells(script: Path) -> str:
    """A notebook (nbformat 4.4) of a script with cells."""
    cells: list[dict[str, object]] = []
    for is_text, cell in cells_of(script):
        kind = "markdown" if is_text else "code"
        outputs: dict[str, object] = {} if is_text else {"execution_count": None, "outputs": []}
        cells.append({"cell_type": kind, "metadata": {}, "source": cell, **outputs})
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return json.dumps(
        {"nbformat": 4, "nbformat_minor": 4, "metadata": {"kernelspec": kernel}, "cells": cells}, indent=1
    )


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let the links of a page lead to where their targets are on the site."""
    root = Path(config.config_file_path).parent
    here = page.file.src_uri
    folder = posixpath.dirname(PAGES.get(here, f"docs/{here}"))

    def led(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match["to"]))
        name = _SITE.get(target) or _SITE.get(f"{target}/README.md")
        if name is None and target.startswith("docs/"):
            name = target.removeprefix("docs/")
        if name is None:
            return match["text"] if (root / target).exists() else match[0]
        return f"[{match['text']}]({posixpath.relpath(name, posixpath.dirname(here) or '.')}{match['anchor'] or ''})"

    code = [match.span() for match in _CODE.finditer(markdown)]
    return _LINK.sub(lambda match: match[0] if any(a <= match.start() < b for a, b in code) else led(match), markdown)
