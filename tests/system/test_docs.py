"""The documentation as files: it is complete, opens without a server, and loads nothing from anywhere else."""

from __future__ import annotations

import enum
import html
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway.client import commands
from protocol.wire import messages
from tests.harness.gateway.chromium import ABSENT, CHROMIUM, chromium
from tests.patience import HANG_S

pytestmark = pytest.mark.slow  # `make docs` builds the same pages, strictly
ROOT = Path(__file__).parents[2]
LOADED = re.compile(r"<(?:script|img|iframe|link)\b[^>]*?\b(?:src|href)=[\"']?([^\"'\s>]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages, built as `make docs` builds them."""
    folder = tmp_path_factory.mktemp("site")
    process = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return folder


def test_pages_load_nothing_from_other_servers(site: Path) -> None:
    pages = list(site.rglob("*.html"))

    loaded = {(page.name, address) for page in pages for address in LOADED.findall(page.read_text(encoding="utf-8"))}

    assert len(pages) > 25
    assert not [(page, address) for page, address in loaded if re.match(r"(?:https?:)?//", address)]


def test_a_script_with_cells_is_a_page_of_text_and_code(site: Path) -> None:
    page = (site / "notebooks" / "subscribe_command_replay.html").read_text(encoding="utf-8")

    assert re.search(r"<h1[^>]*>Subscribe, command, replay", page)
    assert re.search(r"<h2[^>]*>2 Command", page)
    assert re.search(r"<code>.*>import</span>", page)
    assert "%%" not in page
    assert (site / "notebooks" / "subscribe_command_replay.py").is_file()


def test_a_script_with_cells_is_a_notebook_to_download(site: Path) -> None:
    page = (site / "notebooks" / "first_diagnosis.html").read_text(encoding="utf-8")
    notebook = json.loads((site / "notebooks" / "first_diagnosis.ipynb").read_text(encoding="utf-8"))
    script = (ROOT / "docs" / "notebooks" / "first_diagnosis.py").read_text(encoding="utf-8")
    code = [cell["source"] for cell in notebook["cells"] if cell["cell_type"] == "code"]

    assert 'href="first_diagnosis.ipynb"' in page
    assert notebook["nbformat"] == 4
    assert notebook["cells"][0]["source"].startswith("# Your first diagnosis\n\n`board51 demo`")
    assert len(code) == script.count("# %%\n")
    assert all(source in script for source in code)


def test_a_field_of_a_dataclass_of_the_api_has_its_meaning(site: Path) -> None:
    page = (site / "api" / "client.html").read_text(encoding="utf-8")

    assert re.search(r"<code>x_m</code>: position of the ball, m, up from the sensor", page)
    assert page.count('id="gateway.client.Rig.excite"') == 1


def test_an_enumeration_of_the_api_has_its_members(site: Path) -> None:
    pages = " ".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    text = html.unescape(re.sub(r"<[^>]+>", "", pages))
    named = {**vars(commands), **{f"wire {name}": kind for name, kind in vars(messages).items()}}
    kinds: list[type[enum.Enum]] = [
        kind for kind in named.values() if isinstance(kind, type) and issubclass(kind, enum.Enum)
    ]
    members = [f"{member.name} = {member.value!r}" for kind in kinds for member in kind]

    assert len(members) > 40
    assert not [member for member in members if member not in text]


@pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)
def test_the_search_works_from_the_file_system(site: Path) -> None:
    with chromium() as browser:
        page = browser.new_page()
        urls: list[str] = []
        page.on("request", lambda request: urls.append(request.url))

        page.goto((site / "index.html").as_uri())
        page.locator(".md-search__input").first.click()
        page.keyboard.type("innovations likelihood")  # it listens to keys

        expect(page.locator(".md-search-result__item").first).to_contain_text("likelihood", ignore_case=True)
        assert not [url for url in urls if not url.startswith(("file:", "data:", "about:", "blob:"))]
