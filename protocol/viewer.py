"""Opens pages and pictures in the viewer of the system."""

from __future__ import annotations

import os
import sys
import webbrowser


def open_viewer(url: str) -> bool:
    """Open `url` in the system's browser or viewer; return False where there is no screen, or nothing to show it."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    has_screen = sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in screens)
    return has_screen and webbrowser.open(url)
