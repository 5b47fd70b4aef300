"""Debian's Chromium, headless, for the tests that look at pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, expect, sync_playwright

from tests.patience import HANG_MS

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ABSENT = "Debian's chromium is not installed"
expect.set_options(timeout=HANG_MS)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser that ends with the block."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--headless=new", "--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()
