"""Names and docstrings that a student reads at first sight: nouns for data, verbs for functions, no riddles.

The limits only go down.  Whoever lowers a count lowers its limit in the same change.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator

import pytest

from tests.harness.sources import trees

pytestmark = pytest.mark.xdist_group("sources")  # parsed once

# Participles, adverbs and pronouns that do not say what a value is or what a function does.
NOT_NAMES = frozenset(
    """said told found taken shown asked climbed settled given kept judged heard seen done gone wanted worth meant
    few least most fine late near beside own one only along alone alike apart beyond inside nothing others ours
    about here there still by knowing pays rises say tell ask place""".split()
)
EXEMPT_NAMES = frozenset(["kw_only", "zero_copy_only", "encipher_only", "decipher_only"])  # of libraries
# Per cent.  By the same list and count: python-control 0.2, diffrax 0.2, ophyd-async 0.3, h11 1.0.
MAX_SHARE = {"protocol": 0.2, "gateway": 0.2, "twin": 0.3, "tests": 0.1}

# A docstring begins with a verb, or with an article and a noun.
NOT_BEGINNINGS = re.compile(
    r"(Of|What|Those|That|By|From|As|In|With|Without|For|To|Which|Whether|Where|When|Why|How|Who|Whose|Not|Only|One"
    r"|At|On|Into|After|Before|It|Its|This|These|Both|Same|Like|Until|While|Between|About|Over|Under|Here|There"
    r"|Nothing|More|Less|Such|Also|Done|Said|Told|Found)\b"
)
MAX_BEGINNINGS = {"protocol": 0, "gateway": 0, "twin": 0, "tests": 0}


def names(tree: ast.Module) -> Iterator[str]:
    """Yield each name that is defined or passed, as often as it is."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=str(name)) | ast.keyword(arg=str(name)):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case _:
                continue


def words(name: str) -> list[str]:
    return [word.lower() for word in re.split(r"_+|(?<=[a-z0-9])(?=[A-Z])", name) if word]


def test_names_say_what_a_value_is() -> None:
    for package, limit in MAX_SHARE.items():
        counted = Counter(name for _, tree in trees(package) for name in names(tree))
        bad = {
            name: n
            for name, n in counted.items()
            if name not in EXEMPT_NAMES and not name.startswith("test_") and not NOT_NAMES.isdisjoint(words(name))
        }
        share = 100.0 * sum(bad.values()) / counted.total()

        assert share <= limit, f"{package}: {share:.2f} %: {Counter(bad).most_common(40)}"


def test_a_docstring_begins_with_a_verb_or_an_article() -> None:
    documented = ast.Module | ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    for package, limit in MAX_BEGINNINGS.items():
        bad = [
            f"{path}:{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}"
            for path, tree in trees(package)
            for node in ast.walk(tree)
            if isinstance(node, documented)
            and not getattr(node, "name", "").startswith("test_")  # it argues for its test
            and (text := ast.get_docstring(node))
            and NOT_BEGINNINGS.match(text)
        ]

        assert len(bad) <= limit, "\n".join([f"{package}: {len(bad)}", *bad])
