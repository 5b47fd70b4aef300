"""The templates of the reports: whatever they show is escaped, and a value that is missing is an error."""

from __future__ import annotations

from itertools import pairwise

import pytest
from jinja2 import UndefinedError

from twin.page.figures import EXTENDED, MEASURED, MODEL, grid, inline, styled
from twin.page.render import render

VALUES = {
    "title": "<script>alert(1)</script>",
    "answer": 'K_c & "b" < 0',
    "colour": "pass",
    "picture": None,
    "points": [["<b>1</b>", "2"]],
    "members": [],
    "proposals": [],
    "rejected": ["a<b"],
    "not_testable": [],
    "warnings": [],
}


@styled
def drawn_twice() -> list[bytes]:
    sources = []
    for _ in range(2):
        figure, ((ax,),) = grid(1, 1, height=2.0)
        ax.plot([0.0, 1.0], [2.0, 3.0])
        sources.append(inline(figure, "a line").source.encode())
    return sources


def equilibria(**values: object) -> str:
    figure, _ = grid(1, 1, height=2.0)
    picture = inline(figure, 'x "in" mm', "png")
    return render("diagnosis/equilibria/page.html", **{**VALUES, "picture": picture, **values})


def test_names_and_sentences_are_escaped_wherever_they_stand() -> None:
    html = equilibria()

    assert "<script" not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 2
    assert "<td>&lt;b&gt;1&lt;/b&gt;</td>" in html
    assert "<li>a&lt;b</li>" in html
    assert 'alt="x &#34;in&#34; mm" src="data:image/png;base64,' in html


def test_a_page_needs_nothing_else() -> None:
    html = equilibria()

    assert "max-width: 1120px" in html
    assert 'rel="stylesheet"' not in html
    assert html.count("src=") == html.count('src="data:')


def test_a_value_that_a_template_misses_is_an_error() -> None:
    values = {name: value for name, value in VALUES.items() if name != "rejected"}

    with pytest.raises(UndefinedError, match="rejected"):
        render("diagnosis/equilibria/page.html", **{**values, "picture": inline(grid(1, 1, height=2.0)[0], "x")})


def test_the_same_numbers_give_the_same_bytes() -> None:
    first, second = drawn_twice()

    assert first == second


def test_colours_differ_in_a_print_without_colour() -> None:
    def luminance(colour: str) -> float:
        red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
        return 0.299 * red + 0.587 * green + 0.114 * blue  # ITU-R BT.601

    levels = sorted(map(luminance, (MEASURED, MODEL, EXTENDED)))

    assert all(above - below > 30.0 for below, above in pairwise(levels))
