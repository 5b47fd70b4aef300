"""MATLAB files, against another reader's writer; and damaged ones, on which that reader ends the process."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from protocol.mat_file import BrokenMatError, MatTooLargeError, Numbers, parse_mat
from tests.examples import costly

NUMBERS = st.sampled_from(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
arrays = st.builds(
    lambda kind, rows, columns, seed: np.random.default_rng(seed).integers(0, 100, (rows, columns)).astype(kind),
    NUMBERS, st.integers(0, 5), st.integers(0, 5), st.integers(0, 99),
)  # fmt: skip
names = st.from_regex("[a-z][a-z0-9_]{0,20}", fullmatch=True)
LARGEST = 100_000


def saved(content: dict[str, Any], **options: Any) -> bytes:
    out: Any = io.BytesIO()
    savemat(out, content, **options)
    return bytes(out.getvalue())


@settings(max_examples=costly(100))
@given(
    content=st.dictionaries(names, arrays | st.dictionaries(names, arrays, min_size=1), min_size=1),
    packed=st.booleans(),
)
def test_what_is_saved_is_read(content: dict[str, Any], packed: bool) -> None:
    parsed = parse_mat(saved(content, do_compression=packed), LARGEST)

    assert parsed.keys() == content.keys()
    for name, value in content.items():
        entry = parsed[name]
        for inner, expected in value.items() if isinstance(value, dict) else [(None, value)]:
            array = entry if inner is None else entry[inner] if isinstance(entry, dict) else None
            assert isinstance(array, Numbers)
            assert array.shape == expected.shape
            assert list(array.values) == expected.ravel(order="F").tolist()


def test_what_is_no_array_of_real_numbers_says_why() -> None:
    from scipy.sparse import eye_array

    content = {"a": "text", "b": np.array([1j]), "c": np.array([{}, "x"], object), "d": eye_array(3).tocsc()}

    assert parse_mat(saved(content), LARGEST) == {
        "a": "it is text",
        "b": "it is complex",
        "c": "it is a cell or struct array of 1 x 2; save vectors of numbers",
        "d": "it is sparse; save it with full()",
    }


def test_a_file_of_the_other_byte_order() -> None:
    element = struct.pack(">IIII", 6, 8, 6, 0) + struct.pack(">IIii", 5, 8, 1, 2)  # flags: double; dimensions
    element += struct.pack(">HH4s", 1, 1, b"x") + struct.pack(">IIdd", 9, 16, 1.0, 2.5)
    data = b"MATLAB".ljust(124) + b"\x01\x00MI" + struct.pack(">II", 14, len(element)) + element

    parsed = parse_mat(data, LARGEST)["x"]

    assert isinstance(parsed, Numbers)
    assert list(parsed.values) == [1.0, 2.5]


def test_a_file_that_expands_is_refused() -> None:
    with pytest.raises(MatTooLargeError):
        parse_mat(saved({"x": np.zeros(LARGEST)}, do_compression=True), LARGEST)


def test_every_cut_is_an_error() -> None:
    data = saved({"t": np.arange(3.0), "run": {"x": np.arange(3.0)}})
    whole = [len(saved({"t": np.arange(3.0)})), len(data), 128]

    for end in set(range(len(data))) - set(whole):
        with pytest.raises(BrokenMatError):
            parse_mat(data[:end], LARGEST)
