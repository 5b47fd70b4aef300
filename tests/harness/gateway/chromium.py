"""Debian's Chromium, headless, for the tests that look at pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.patience import HANG_MS, WORK_MS

# The shell has no windows: it needs two thirds of the processor time and starts in a third of the time.
_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser")
CHROMIUM = next(filter(None, map(shutil.which, _NAMES)), None)
ABSENT = "Debian's chromium-headless-shell or chromium is not installed"
expect.set_options(timeout=HANG_MS)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser that ends with the block."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@contextmanager
def open_tab(browser: Browser, *, width: int = 1400, height: int = 900, url: str | None = None) -> Iterator[Page]:
    """Open a tab, whose addresses begin with `url`; no script in it may fail."""
    context = browser.new_context(viewport={"width": width, "height": height}, base_url=url)
    context.set_default_timeout(HANG_MS)
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    context.close()
    assert errors == []


def start_job(page: Page, name: str) -> None:
    """Press the button of that name as soon as it may be pressed; the server must answer that its job has started."""
    with page.expect_response("**/job", timeout=WORK_MS) as answer:
        page.get_by_role("button", name=name, exact=True).click(timeout=WORK_MS)
    assert answer.value.json()["accepted"], answer.value.text()
