"""What MkDocs is told beyond `mkdocs.yml`: Markdown that lies beside the code it describes is a page of the site, too.

So is a script with cells (percent format): its text as text, its code as code.
A link in any page is written as it works in the repository.  To a file that is a page here it leads to that page; of
any other file of the repository the link's text stays, since the site holds no source code.
"""

from __future__ import annotations

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
        else:
            files.append(File.generated(config, page, abs_src_path=str(root / file)))
    return files


def page_of_cells(script: Path) -> str:
    """Markdown of a script with cells; below its heading, the script itself to take home."""
    _, *cells = _CELL.split(script.read_text(encoding="utf-8"))
    page = "\n\n".join(
        re.sub(r"^# ?", "", cell.strip(), flags=re.MULTILINE) if is_text else f"```python\n{cell.strip()}\n```"
        for is_text, cell in zip(cells[::2], cells[1::2], strict=True)
    )
    heading, _, rest = page.partition("\n")
    return f'{heading}\n\n<a href="{script.name}" download>Download {script.name}</a>\n{rest}\n'


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
