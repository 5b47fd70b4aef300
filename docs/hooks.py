"""What MkDocs is told beyond `mkdocs.yml`: Markdown that lies beside the code it describes is a page of the site, too.

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
    "gateway.md": "gateway/README.md",
    "views.md": "gateway/views/README.md",
    "theory/twin.md": "twin/README.md",
    "theory/identify.md": "twin/identify/README.md",
    "theory/design.md": "twin/design/README.md",
    "theory/validate.md": "twin/validate/README.md",
    "theory/diagnose.md": "twin/diagnose/README.md",
    "theory/matrix.md": "twin/diagnose/matrix.md",
    "changes.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
}
_SITE = {file: page for page, file in PAGES.items()}
_LINK = re.compile(r"\[(?P<text>[^\]\n]+(?:\n[^\]\n]+)?)\]\((?P<to>[^)\s:#]+)(?P<anchor>#[^)\s]*)?\)")
_CODE = re.compile(r"^```.*?^```|`[^`\n]+`(?!\])", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages whose Markdown lies outside docs/."""
    root = Path(config.config_file_path).parent
    for page, file in PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(root / file)))
    return files


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
