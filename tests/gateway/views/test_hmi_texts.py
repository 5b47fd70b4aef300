"""The texts of the pages are in one file, texts.toml: each is used, no other text is in the code, each can be read."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from jinja2 import Environment, nodes

from gateway.views import hmi
from gateway.views.hmi.texts import FILE, text_of
from tests.harness.sources import parsed

HMI = Path(hmi.__file__).parent
PYTHON = {path.name: parsed(path) for path in HMI.rglob("*.py")}
HTML = [path.name for path in (HMI / "html").glob("*.py")]
TEMPLATES = {path.name: Environment().parse(path.read_text(encoding="utf-8")) for path in (HMI / "html").glob("*.html")}
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in (HMI / "static").glob("*.js")}
SECTIONS = tomllib.loads(FILE.read_text(encoding="utf-8"))
TEXTS = {f"{section}.{name}": text for section, texts in SECTIONS.items() for name, text in texts.items()}
MAX_WORDS = 25
TEXT_ATTRIBUTES = "aria-label|title|placeholder"
UNITS = {"mm"}  # the same in each language
WORDS = re.compile(r"[A-Za-z]{2,} [A-Za-z]{2,}|^[A-Z][a-z]+(?![\w-])")  # two words, or one that begins a sentence
NO_TEXTS = {  # what looks like words and is none: a command, HTML, names of modes, fonts, a key
    "board51 diagnose CAMPAIGN --model MODEL --out %s/NAME", "the twin's model", "open loop", "closed loop",
    "12px system-ui", "px system-ui, sans-serif", "(prefers-color-scheme: dark)", "Escape",
}  # fmt: skip


def placeholders(text: str) -> set[str]:
    return set(re.findall(r"{(\w+)}", text))


def calls(tree: ast.AST, function: str) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == function:
            yield node


def constants(*nodes: ast.AST) -> list[str]:
    inner = [part for node in nodes for part in ast.walk(node)]
    return [part.value for part in inner if isinstance(part, ast.Constant) and isinstance(part.value, str)]


def literals(script: str) -> list[str]:
    """The string literals of a script, templates in the pieces between their values."""
    code = re.sub(r"/\*.*?\*/|(?<![:\"'`\\])//[^\n]*", "", script, flags=re.DOTALL)
    strings = re.findall(r'"((?:[^"\\\n]|\\.)*)"', code)
    for template in re.findall(r"`([^`]*)`", code):
        strings += re.split(r"\${[^}]*}", template)
    return strings


def template_calls(template: nodes.Template, function: str) -> Iterator[tuple[str, list[nodes.Keyword] | None]]:
    """Key and values of each call with a key that is written there."""
    for call in template.find_all(nodes.Call):
        if isinstance(call.node, nodes.Name) and call.node.name == function and isinstance(call.args[0], nodes.Const):
            yield call.args[0].value, call.kwargs


def script_uses() -> Iterator[tuple[str, str, str]]:
    """File, key and the values, as written, of each text in a script."""
    for name, script in SCRIPTS.items():
        for call in re.finditer(r'textOf\("([^"]+)"(?:, ({.*?}|\w+))?\)', script):
            yield name, call[1], call[2] or ""


def test_each_text_is_used_and_each_that_is_used_exists() -> None:
    tables = set(re.findall(r'textsOf\("(\w+)"\)', "\n".join(SCRIPTS.values())))
    keys = {key for _, key, _ in script_uses()}
    for tree in PYTHON.values():
        tables |= {name for call in calls(tree, "texts_of") for name in constants(call.args[0])}
        keys |= {key for call in calls(tree, "text_of") for key in constants(call.args[0])}
        keys |= {word for word in constants(tree) if word in TEXTS}  # in a table of keys
    for template in TEMPLATES.values():
        tables |= {name for name, _ in template_calls(template, "texts_of")}
        keys |= {key for key, _ in template_calls(template, "text_of")}
        keys |= {const.value for const in template.find_all(nodes.Const) if const.value in TEXTS}  # passed to a macro

    assert keys - set(TEXTS) == set()
    assert tables - set(SECTIONS) == set()
    assert {key for key in TEXTS if key not in keys and key.partition(".")[0] not in tables} == set()


def test_each_text_gets_its_values() -> None:
    for file, tree in PYTHON.items():
        for call in calls(tree, "text_of"):
            if isinstance(call.args[0], ast.Constant) and all(value.arg for value in call.keywords):
                key = str(call.args[0].value)
                assert {value.arg for value in call.keywords} == placeholders(TEXTS[key]), f"{file}: {key}"
    for file, template in TEMPLATES.items():
        for key, named in template_calls(template, "text_of"):
            assert {value.key for value in named or ()} == placeholders(TEXTS[key]), f"{file}: {key}"
    for file, key, values in script_uses():
        if values.startswith("{") and "..." not in values:
            names = re.sub(r"\([^()]*\)", "", values.strip("{} "))
            names = re.sub(r"\([^()]*\)", "", names)
            assert {part.split(":")[0].strip() for part in names.split(",")} == placeholders(TEXTS[key]), (
                f"{file}: {key}"
            )
        elif not values:
            assert not placeholders(TEXTS[key]), f"{file}: {key}"


@pytest.mark.parametrize("name", HTML)
def test_no_page_has_a_text_of_its_own(name: str) -> None:
    documentation = [node for node in ast.walk(PYTHON[name]) if isinstance(node, ast.Expr)]
    words = set(constants(PYTHON[name])) - set(constants(*documentation)) - NO_TEXTS

    assert [word for word in words if WORDS.search(word)] == []


@pytest.mark.parametrize("name", TEMPLATES)
def test_no_template_has_a_text_of_its_own(name: str) -> None:
    template = TEMPLATES[name]
    markup = "".join(
        part.data if isinstance(part, nodes.TemplateData) else "{}"
        for output in template.find_all(nodes.Output)
        for part in output.nodes
    )
    content = re.findall(r"[A-Za-z]+", re.sub(r"<[^>]*>", " ", markup))
    attributes = re.findall(rf'\b(?:{TEXT_ATTRIBUTES})="([^"]*[A-Za-z][^"]*)"', markup)
    passed = {
        const.value
        for call in template.find_all(nodes.Call)
        for const in call.find_all(nodes.Const)
        if isinstance(const.value, str)
    }

    assert set(content) <= UNITS
    assert attributes == []
    assert [word for word in passed - NO_TEXTS - set(TEXTS) if WORDS.search(word)] == []


@pytest.mark.parametrize("name", PYTHON)
def test_no_refusal_has_a_text_of_its_own(name: str) -> None:
    for call in calls(PYTHON[name], "refusal"):
        words = constants(call)
        if not {"malformed", "empty-command"} & set(words):  # of a program that is not a page
            assert [word for word in words if WORDS.search(word)] == []


@pytest.mark.parametrize("name", SCRIPTS)
def test_no_script_has_a_text_of_its_own(name: str) -> None:
    words = re.findall(r'(?:textContent = |\b(?:cell|element)\("\w+", |\bput\("[\w-]+", )["`]([^"`$]*)', SCRIPTS[name])

    assert [word for word in literals(SCRIPTS[name]) if WORDS.search(word) and word not in NO_TEXTS] == []
    assert [word for word in words if re.search(r"[A-Za-z]", word)] == []


def test_the_style_sheet_has_no_text() -> None:
    contents = re.findall(r'content: "([^"]*)"', (HMI / "static" / "hmi.css").read_text(encoding="utf-8"))

    assert [text for text in contents if re.search(r"(?<!\\)\b[A-Za-z]{2,}", re.sub(r"\\[0-9a-f]+", "", text))] == []


def test_texts_are_short_sentences() -> None:
    for key, text in TEXTS.items():
        assert text == " ".join(text.split()), key
        assert max(len(sentence.split()) for sentence in re.split(r"(?<=[.!?;])\s+", text)) <= MAX_WORDS, key
        assert "{" not in text_of(key, **dict.fromkeys(placeholders(text), "1")), key


def test_a_value_does_not_become_a_placeholder_or_html() -> None:
    assert text_of("stop.coil_of", rig="{coil}", coil="<b>") == "{coil}: <b>"
