"""Heads of `.npy` files: as numpy reads them where it can, a sentence for everything else, and nothing evaluated."""

from __future__ import annotations

import io
import tokenize
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.lib import format as numpys

from salad.npy import NpyHead, read_head

KINDS = ["<f2", "<f4", ">f8", "|u1", "<i8", "|b1", "<U7", "|S3", "<c16"]
SHAPES = st.lists(st.integers(0, 4), max_size=4).map(tuple)


def with_head(text: str | bytes, version: int = 1) -> bytes:
    """A file of this head and nothing behind it."""
    said = text.encode("latin-1") if isinstance(text, str) else text
    return b"\x93NUMPY" + bytes([version, 0]) + len(said).to_bytes(2 if version == 1 else 4, "little") + said


@given(shape=SHAPES, kind=st.sampled_from(KINDS), by_columns=st.booleans(), version=st.sampled_from([(1, 0), (2, 0)]))
def test_what_numpy_writes_is_read(shape: tuple[int, ...], kind: str, by_columns: bool, version: Any) -> None:
    array = np.zeros(shape, dtype=kind, order="F" if by_columns else "C")
    file = io.BytesIO()
    numpys.write_array(file, array, version=version)
    head = read_head(io.BytesIO(file.getvalue()))
    assert (head.shape, np.dtype(head.code), head.count) == (shape, np.dtype(kind), array.size)
    assert head.by_columns == (array.flags.f_contiguous and not array.flags.c_contiguous)
    assert len(file.getvalue()) - head.start == array.nbytes


@pytest.mark.parametrize(
    "text",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }",
        '{"descr": "<f4","fortran_order":False,"shape":(3,4)}',
        "{'shape': (3L, 4L), 'fortran_order': False, 'descr': '<f4'}   \n",
        "{ 'fortran_order' : False , 'shape' : ( 3 , 4 , ) , 'descr' : '<f4' , }",
    ],
)
@pytest.mark.parametrize("version", [1, 2, 3])
def test_what_other_programs_write_is_read(text: str, version: int) -> None:
    assert read_head(io.BytesIO(with_head(text, version))).shape == (3, 4)


ODD = [
    "",
    "{}",
    "(" * 5000,
    "[" * 9000,
    "{'descr': " + "(" * 2000 + ")" * 2000 + ", 'fortran_order': False, 'shape': (1,)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (True, 4)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 4)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1_0, 4)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1e3, 4)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (3)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1" + "0" * 26 + ", 4)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (" + "1," * 99 + ")}",
    "{'descr': '<f4', 'fortran_order': 0, 'shape': (1,)}",
    "{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (1,)}",
    "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1,)} or exit()",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), 'more': 1}",
    "{'descr': '" + "x" * 9000 + "', 'fortran_order': False, 'shape': (1,)}",
]


@pytest.mark.parametrize("text", ODD)
def test_odd_heads_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="its head"):
        read_head(io.BytesIO(with_head(text)))


def test_what_is_cut_short_or_of_another_format_is_told() -> None:
    whole = with_head("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4)}")
    for length in range(len(whole)):
        with pytest.raises(ValueError, match=r"its head|its first bytes"):
            read_head(io.BytesIO(whole[:length]))
    with pytest.raises(ValueError, match=r"version 9\.0"):
        read_head(io.BytesIO(with_head("{}", 9)))
    with pytest.raises(ValueError, match=r"version 2\.0"):
        read_head(io.BytesIO(with_head("{}", 2)), newest=1)
    with pytest.raises(ValueError, match="cut short"):  # it says four gigabytes, and none are taken
        read_head(io.BytesIO(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{"))


SAID = st.text(st.sampled_from("{}()[]'\":, descrfotan_shpeTuFl<>|0123456789L-\n"), max_size=120)


@given(text=SAID | st.binary(max_size=80), version=st.sampled_from([1, 2]))
@example(text="{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }", version=1)
def test_any_head_is_read_as_numpy_reads_it_or_refused(text: str | bytes, version: int) -> None:
    data = with_head(text, version)
    try:
        head = read_head(io.BytesIO(data))
    except ValueError:
        return
    assert isinstance(head, NpyHead)
    read = numpys.read_array_header_1_0 if version == 1 else numpys.read_array_header_2_0
    shape, by_columns, kind = read(io.BytesIO(data[8:]))
    assert (head.shape, head.by_columns, np.dtype(head.code)) == (shape, by_columns, kind)


@given(where=st.integers(0, 70), byte=st.integers(0, 255))
def test_a_changed_byte_is_read_as_numpy_reads_it_or_refused(where: int, byte: int) -> None:
    text = bytearray(b"{'descr': '<f4', 'fortran_order': False, 'shape': (312, 44), }         ")
    text[where] = byte
    try:
        head = read_head(io.BytesIO(with_head(bytes(text))))
    except ValueError:
        return
    try:
        shape, by_columns, kind = numpys.read_array_header_1_0(io.BytesIO(with_head(bytes(text))[8:]))
    except (ValueError, tokenize.TokenError):  # a kind that numpy does not know, which is for whoever reads on to say
        assert head.shape == (312, 44)
        return
    assert (head.shape, head.by_columns) == (shape, by_columns)
    assert np.dtype(head.code) == kind
