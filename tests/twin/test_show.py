"""`--show`: the viewer of the system gets the file, and without a screen its place is said."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import pytest

import board51


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Provide the list of URLs that the browser was asked to open, on a screen."""
    urls: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", lambda url: not urls.append(url))  # type: ignore[func-returns-value]  # None is the answer
    return urls


def test_a_design_is_shown_as_a_page(opened: list[str], tmp_path: Path) -> None:
    assert board51.main(["design", "ce152", "--out", "controller.json", "--show"]) == 0

    page = tmp_path / "controller.html"
    assert opened == [page.as_uri()]
    text = page.read_text(encoding="utf-8")
    assert "<h1>Controller from ce152</h1>" in text
    assert "phase margin" in text


def test_without_a_screen_the_place_is_said(
    opened: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)

    assert board51.main(["design", "ce152", "--show"]) == 0

    assert opened == []
    assert "no screen to show it: see design.html" in capsys.readouterr().err


def test_predictions_are_drawn(opened: list[str], tmp_path: Path) -> None:
    rows = "".join(f"{2e-3 * n:.3f},1.0,0.4,0.0\n" for n in range(500))
    (tmp_path / "rest.csv").write_text(f"t,u_c,i_c,x\n{rows}", encoding="utf-8")

    board51.main(["predict", "ce152", "rest.csv", "--show"])

    assert opened == [(tmp_path / "predict.html").as_uri()]
    assert "data:image/png" in (tmp_path / "predict.html").read_text(encoding="utf-8")
