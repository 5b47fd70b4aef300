"""Browsers: `browsers.py FOLDER PORT COUNT BOARDS`; headless Chromium, each on the page of a board of its own.

Each is a context of its own, hence another visitor with another session and another renderer.  Prints `ready` once all
pages show live values; counts from SIGUSR1 on; on SIGTERM writes frames.json with what came, per browser: frames per
second, the longest time between two in ms, and how often the shown position changed per second.
"""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import signal
import sys
import time
from pathlib import Path

from playwright.async_api import async_playwright

from tests.harness.gateway.chromium import CHROMIUM

LIVE_MS = 300_000.0  # for a page to come up where everything else goes first
# Counted in the page: to hand each frame out to this process would cost more than the page itself.
COUNT = """
window.frames_seen = 0; window.longest_ms = 0; window.values_shown = 0;
let last = null;
const Plain = window.WebSocket;
window.WebSocket = class extends Plain {
    constructor(...words) {
        super(...words);
        if (String(words[0]).includes('/live')) this.addEventListener('message', () => {
            const now = performance.now();
            if (last !== null) window.longest_ms = Math.max(window.longest_ms, now - last);
            last = now;
            window.frames_seen += 1;
        });
    }
};
"""
WATCH_VALUES = """() => {
    window.frames_seen = 0; window.longest_ms = 0; window.values_shown = 0;
    const options = { childList: true, characterData: true, subtree: true };
    new MutationObserver(() => { window.values_shown += 1; })
        .observe(document.querySelector('[data-live=x]'), options);
}"""


PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23  # prctl(2), capabilities(7)


def keep_below() -> None:
    """Chromium lifts its threads to nice 0 and -8, above the gateway, where it may: as root it may.  Not here."""
    os.nice(int(os.environ.get("BOARD51_BENCH_NICE", "0")))
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)  # fails for who is not root, and may not anyway


async def main(folder: Path, port: int, count: int, boards: int) -> None:
    """Look until SIGTERM."""
    begin, stop = asyncio.Event(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, begin.set)
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    async with async_playwright() as playwright:
        chromium = await playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"], handle_sigterm=False
        )
        pages = []
        for n in range(count):
            context = await chromium.new_context(viewport={"width": 1280, "height": 800})
            await context.add_init_script(COUNT)
            page = await context.new_page()
            await page.goto(f"http://127.0.0.1:{port}/rig/b{n % boards}", timeout=LIVE_MS)
            await page.wait_for_selector("body[data-live=yes]", timeout=LIVE_MS)
            pages.append(page)
        print("ready", flush=True)
        await begin.wait()
        for page in pages:
            await page.evaluate(WATCH_VALUES)
        begun_s = time.monotonic()
        await stop.wait()
        took_s = time.monotonic() - begun_s
        totals = [await page.evaluate("[window.frames_seen, window.longest_ms, window.values_shown]") for page in pages]
        counts = [
            {"per_s": frames / took_s, "longest_ms": longest, "values_per_s": values / took_s}
            for frames, longest, values in totals
        ]
        (folder / "frames.json").write_text(json.dumps(counts), encoding="utf-8")
        await chromium.close()


if __name__ == "__main__":
    keep_below()
    asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
