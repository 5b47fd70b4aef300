"""The targets of the fuzzer run, and what is wrong is a finding: `tests/harness/fuzzing.py` does not rot."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from tests.examples import costly
from tests.harness.fuzz_targets import TARGETS, change_messages, check_finite, pack, unpack
from tests.harness.fuzzing import Findings

COSTLY = {
    "bus, twin": 6,
    "bus, command": 20,
    "bus, OPC UA": 20,
    "users": 6,
    "configuration": 30,
    "model": 30,
    "bus, model": 30,
}  # others: 100


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, about absurd numbers
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.slow
def test_a_target_takes_its_seeds_and_changes_of_them(name: str, tmp_path: Path) -> None:
    target, chance, kinds = TARGETS[name], Random(name), list[str]()
    seeds = list(target.seeds(tmp_path))
    findings = Findings(lambda data: target.run(tmp_path, data), lambda kind, *_: kinds.append(kind))

    for _ in range(costly(COSTLY.get(name, 100))):
        data = chance.choice(seeds)
        for _ in range(chance.randint(0, 3)):
            data = target.change(chance, data)
        findings.execute(data)

    assert not kinds


def test_what_a_parser_raises_is_found_once_with_its_input() -> None:
    reported: list[tuple[str, bytes]] = []
    findings = Findings(lambda data: check_finite([float(data)]), lambda kind, data, _: reported.append((kind, data)))

    for data in (b"1", b"nan", b"inf", b"x"):
        findings.execute(data)

    assert [data for _, data in reported] == [b"nan", b"x"]
    assert [kind.split(" at ")[0] for kind, _ in reported] == ["FuzzError", "ValueError"]
    assert findings.executions == 4


def test_any_bytes_are_messages() -> None:
    chance, data = Random(1), b""
    for _ in range(200):
        data = change_messages(chance, data + chance.randbytes(chance.randrange(60)))
        assert list(unpack(pack(unpack(data)))) == list(unpack(data))
