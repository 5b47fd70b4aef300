"""The description of the API is that of the server, and says what the rest of the software says."""

from __future__ import annotations

import argparse
import ast
import re
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

import gateway
from gateway.client import commands as client
from gateway.client.commands import HostLoss, Law, Shape
from gateway.commands import send
from gateway.views.hmi.api import commands, endpoints, forms, job_endpoints, openapi, rigs, shapes
from gateway.views.hmi.html.api_page import operations
from gateway.views.hmi.problems import REMEDIES
from gateway.views.hmi.starts import STARTS
from protocol.checked import keys_of, plain_of
from protocol.wire.messages import Reason
from tests.harness.sources import parsed


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    table = endpoints.Endpoints.table(endpoints.Endpoints.__new__(endpoints.Endpoints))
    table += job_endpoints.WorkEndpoints.table(job_endpoints.WorkEndpoints.__new__(job_endpoints.WorkEndpoints))
    return openapi.document(table, release="0", has_users=True)


def references(part: object) -> set[str]:
    if isinstance(part, dict):
        direct = {part["$ref"]} if isinstance(part.get("$ref"), str) else set()
        return direct.union(*map(references, part.values()))
    return set().union(*map(references, part)) if isinstance(part, list) else set()


def test_every_reference_and_every_part_of_a_path_is_described(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]

    assert {reference.removeprefix("#/components/schemas/") for reference in references(document)} <= set(schemas)
    identifiers = [operation["operationId"] for path in document["paths"].values() for operation in path.values()]
    assert len(set(identifiers)) == len(identifiers)
    for path, methods in document["paths"].items():
        for operation in methods.values():
            named = {p["name"] for p in operation["parameters"] if p["in"] == "path"}
            assert named == set(re.findall(r"{(\w+)}", path))
            assert operation["summary"]
            assert all(parameter["description"] for parameter in operation["parameters"])


def test_the_commands_are_those_of_send(document: dict[str, Any]) -> None:
    parser = argparse.ArgumentParser()
    send.configure(parser)
    (action,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]

    described = document["components"]["schemas"]
    (schema,) = document["paths"]["/rigs/{rig}/commands"]["post"]["requestBody"]["content"].values()
    assert set(action.choices) == set(commands.KINDS)
    assert set(schema["schema"]["discriminator"]["mapping"]) == set(commands.KINDS)
    assert {described[kind.__name__]["properties"]["command"]["const"] for kind, _ in commands.KINDS.values()} == set(
        commands.KINDS
    )


def test_every_kind_of_job_can_be_named_and_interrupted(document: dict[str, Any]) -> None:
    (schema,) = document["paths"]["/rigs/{rig}/jobs"]["post"]["requestBody"]["content"].values()

    assert set(schema["schema"]["discriminator"]["mapping"]) == set(forms.JOBS)
    assert set(get_args(forms.Kind)) == set(STARTS) - {"replay"}


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (shapes.Mode, client.Mode),
        (keys_of(commands.SetGains)["law"], Law),
        (keys_of(commands.Excite)["shape"], Shape),
        (keys_of(commands.SetHostLoss)["policy"], HostLoss),
    ],
)
def test_words_of_a_body_are_those_of_the_bus(hint: Any, words: Any) -> None:
    assert get_args(plain_of(hint)) == tuple(map(str, words))


def test_the_columns_are_the_fields_of_a_sample() -> None:
    assert list(get_type_hints(shapes.States)) == list(get_type_hints(shapes.State)) == rigs.HEADER.split(",")


def test_every_reason_for_a_refusal_of_a_command_has_a_remedy() -> None:
    reasons = {reason.name.lower().replace("_", "-") for reason in Reason}
    room = Path(gateway.__file__).parent
    for path in [*(room / "board").rglob("*.py"), *(room / "link").rglob("*.py"), *(room / "access").rglob("*.py")]:
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Refusal":
                first = node.args[0]
                reasons |= {first.value} if isinstance(first, ast.Constant) and isinstance(first.value, str) else set()

    assert len(reasons) > 20
    assert sorted(reasons - set(REMEDIES)) == []


def test_the_page_lists_every_operation_with_its_keys(document: dict[str, Any]) -> None:
    listing = list(operations(document))

    assert len(listing) == sum(map(len, document["paths"].values()))
    command = next(operation for operation in listing if operation["name"].endswith("/commands"))
    assert len(command["bodies"]) == len(commands.KINDS)
    rig = next(operation for operation in listing if operation["name"].endswith("/rigs/{rig}"))
    ((_, keys),) = rig["answers"]
    assert {"alarms.name", "divergence.nis_mean", "limits.gains"} <= {row.name for row in keys}
    states = next(operation for operation in listing if operation["name"].endswith("/states"))
    assert [(row.name, row.kind) for row in states["query"][1:]] == [
        ("last_s", "number 0 .. 60"),
        ("format", '"json" | "csv"'),
    ]


def test_the_how_to_names_every_path(document: dict[str, Any]) -> None:
    page = (Path(gateway.__file__).parents[1] / "docs" / "howto" / "clients.md").read_text(encoding="utf-8")
    examples = {"{rig}": "rig1", "{model}": "NAME", "{log}": "NAME", "{result}": "RESULT"}

    for path in document["paths"]:
        route = re.sub(r"{\w+}", lambda part: examples[part[0]], path)
        assert (
            route in page or f".../{route.partition('/rig1/')[2]}" in page or f"...{route[route.rindex('/') :]}" in page
        )
