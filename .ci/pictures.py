"""Make the pictures of README and docs anew: control room, story, demo.  `make pictures`; docs/assets/ receives them.

They show an emulated rig, flown by the commands and buttons of a user.  Needs Debian's
chromium-headless-shell or chromium; takes about 4 minutes.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect

from tests.harness.gateway.chromium import ABSENT, CHROMIUM, chromium

ASSETS = Path(__file__).resolve().parents[1] / "docs" / "assets"
PAGE, BUS = "127.0.0.1:8751", "tcp/127.0.0.1:8747"
SIZE = {"width": 1280, "height": 800}
WORK_MS, SETTLE_S, STAIRS_MM = 300_000.0, 4.0, ("2.5", "3.5", "2.0", "3.0")
FRAME_MS, STORY_WIDTH, COLOURS = 1800, 800, 64


def board51(*arguments: str) -> list[str]:
    """Return the command line of this checkout's command."""
    return [sys.executable, "-m", "board51", *arguments]


@contextmanager
def rig(folder: Path) -> Iterator[None]:
    """Run an emulated rig with gateway, twin and control room until the block ends."""
    start = board51("start", "--emulated", "--no-browser", "--page", PAGE, "--listen", BUS, "--log-dir", "logs")
    process = subprocess.Popen(start, cwd=folder)
    try:
        deadline = time.monotonic() + 300.0
        while True:
            try:
                page = urllib.request.Request(f"http://{PAGE}/", headers={"Accept": "text/html"})
                urllib.request.urlopen(page, timeout=10.0).close()
                break
            except (urllib.error.URLError, OSError):
                if process.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit("board51 start does not answer: see its lines above") from None
                time.sleep(0.5)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def picture(page: Page) -> Image.Image:
    """Return what the browser shows."""
    return Image.open(BytesIO(page.screenshot())).convert("RGB")


def press(page: Page, name: str) -> None:
    """Press the first button whose name begins so, as soon as it can be pressed."""
    page.get_by_role("button", name=re.compile(f"^{name}")).first.click(timeout=WORK_MS)


def set_reference(page: Page, millimetres: str) -> None:
    """Type a reference into the page of the rig."""
    field = page.locator('input[data-number="reference"], [data-number="reference"] input').first
    field.fill(millimetres)
    field.press("Enter")


def fly(page: Page, frames: list[Image.Image]) -> None:
    """Lift the ball and fly a staircase; a frame for each step."""
    page.click('[data-mode="closed loop"]')
    expect(page.get_by_text("no twin")).to_be_hidden(timeout=WORK_MS)
    for reference in STAIRS_MM:
        set_reference(page, reference)
        time.sleep(SETTLE_S)
        frames.append(picture(page))


def story(page: Page) -> list[Image.Image]:
    """Fly, measure, identify, diagnose, and fly on with the model that has the cause: the frames of it."""
    frames: list[Image.Image] = []
    page.goto(f"http://{PAGE}/rig/rig1")
    time.sleep(SETTLE_S)
    frames.append(picture(page))
    fly(page, frames)
    picture(page).quantize(256).save(ASSETS / "control-room.png", optimize=True)
    page.click('[data-mode="idle"]')
    page.goto(f"http://{PAGE}/model/rig1")
    press(page, "Run quick")
    expect(page.locator(".job-lines").first).to_contain_text("[1/", timeout=WORK_MS)
    frames.append(picture(page))
    press(page, "Identify")
    expect(page.locator(".results").get_by_text("identified model, campaign of")).to_be_visible(timeout=WORK_MS)
    frames.append(picture(page))
    press(page, "Diagnose, quick")
    expect(page.locator(".sentence")).to_contain_text("coil sits", timeout=WORK_MS)
    page.locator(".sentence").first.scroll_into_view_if_needed()
    frames += [picture(page)] * 2
    extended = page.locator(".card", has_text="Models").locator(".file", has_text="extended model")
    extended.get_by_role("button", name="Hand over to the twin").click(timeout=WORK_MS)
    expect(extended.get_by_text("in use")).to_be_visible(timeout=WORK_MS)
    page.goto(f"http://{PAGE}/rig/rig1")
    fly(page, frames)
    return frames


def main() -> int:
    """Write the three pictures; returns the exit code."""
    if CHROMIUM is None:
        print(f"pictures: {ABSENT}. Install it: apt-get install chromium-headless-shell", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with rig(folder), chromium() as browser:
            page = browser.new_page(viewport=SIZE, color_scheme="light")
            frames = story(page)
        height = round(STORY_WIDTH * SIZE["height"] / SIZE["width"])
        small = [frame.resize((STORY_WIDTH, height), Image.Resampling.LANCZOS).quantize(COLOURS) for frame in frames]
        small[0].save(
            ASSETS / "story.gif", save_all=True, append_images=small[1:], duration=FRAME_MS, loop=0, optimize=True
        )
        subprocess.run(board51("demo", "--out", "demo"), cwd=folder, check=True)
        with Image.open(folder / "demo" / "measured-vs-twin.png") as flown:
            flown.convert("RGB").quantize(128).save(ASSETS / "demo.png", optimize=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
