"""Effects nobody is told: drawn alike from the same seed, sealed, opened unchanged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gateway.emulator.plant.effects import EFFECTS, check
from gateway.emulator.plant.secret import draw, open_sealed, seal
from protocol.errors import DataError, UsageError


def test_draws_are_one_to_three_effects_of_plausible_strength() -> None:
    draws = [draw(seed) for seed in range(300)]

    for effects in draws:
        assert 1 <= len(effects) <= 3
        check(effects)
        for name, value in effects.items():
            effect = EFFECTS[name]
            ends = sorted((effect.weak, effect.strong))
            mirrored = 2.0 * effect.neutral - value if effect.signed else value
            assert any(ends[0] * 0.99 <= v <= ends[1] * 1.01 for v in (value, mirrored)), name
    assert {name for effects in draws for name in effects} == set(EFFECTS)
    assert {len(effects) for effects in draws} == {1, 2, 3}


def test_both_signs_are_drawn_where_both_are_plausible() -> None:
    values = [draw(seed).get("constant-force", 0.0) for seed in range(300)]

    assert min(values) < 0.0 < max(values)


def test_no_draw_delays_the_loop_twice() -> None:
    delaying = {"actuation-delay", "eddy-current-lag", "position-sensor-lag", "sampling-delay"}

    assert all(len(delaying & draw(seed).keys()) <= 1 for seed in range(300))


def test_the_same_seed_draws_the_same_and_another_one_does_not() -> None:
    assert draw(51) == draw(51)
    assert draw(51) != draw(52)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(UsageError, match="Seed -1"):
        draw(-1)


def test_a_sealed_file_opens_to_what_was_sealed(tmp_path: Path) -> None:
    effects = draw(7)

    seal(tmp_path / "sealed.json", effects)

    assert open_sealed(tmp_path / "sealed.json") == effects


def test_a_sealed_file_shows_neither_names_nor_strengths(tmp_path: Path) -> None:
    path = tmp_path / "sealed.json"
    commitment = seal(path, {"quadratic-drag": 1.23})

    text = path.read_text()

    assert commitment in text
    assert not any(name in text for name in EFFECTS)
    assert "1.23" not in text


def test_the_commitment_is_salted(tmp_path: Path) -> None:
    assert seal(tmp_path / "a", {"quadratic-drag": 1.0}) != seal(tmp_path / "b", {"quadratic-drag": 1.0})


def test_sealing_again_keeps_the_file_if_the_effects_are_the_same_and_refuses_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "sealed.json"
    first = seal(path, draw(1))
    written = path.read_bytes()

    assert seal(path, draw(1)) == first
    with pytest.raises(UsageError, match="not the seal of this seed"):
        seal(path, draw(2))

    assert path.read_bytes() == written


@pytest.mark.parametrize("key", ["content", "commitment"])
def test_a_changed_file_is_found_out(tmp_path: Path, key: str) -> None:
    path, other = tmp_path / "sealed.json", tmp_path / "other.json"
    seal(path, draw(1))
    seal(other, draw(2))
    envelope = json.loads(path.read_text())
    envelope[key] = json.loads(other.read_text())[key]
    path.write_text(json.dumps(envelope))

    with pytest.raises(DataError, match="differ"):
        open_sealed(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "\x00\xff",
        '{"format": "board51-sealed-effects-1"}',
        '{"format": "board51-sealed-effects-1", "content": "!"}',
        '{"format": "board51-sealed-effects-1", "content": "\\u00e9", "commitment": ""}',
    ],
)
def test_what_is_not_a_sealed_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "sealed.json"
    path.write_bytes(text.encode("latin-1"))

    with pytest.raises(DataError, match=r"sealed\.json"):
        open_sealed(path)


def test_a_missing_file_and_a_missing_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        open_sealed(tmp_path / "none.json")
    with pytest.raises(UsageError, match="cannot be written"):
        seal(tmp_path / "none" / "sealed.json", draw(1))
