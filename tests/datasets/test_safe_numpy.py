"""Arrays from strangers: what numpy saves comes out as numpy reads it; nothing is run; damage is a sentence."""

from __future__ import annotations

import io
import itertools
import os
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from salad.datasets import safe_numpy
from salad.datasets.safe_numpy import parse_npy, read_npy, read_npz
from salad.errors import BenchmarkError

Rows = st.lists(st.lists(st.integers(-(2**40), 2**40), max_size=6), max_size=12)


def saved(array: np.ndarray[Any, Any]) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


@settings(max_examples=80)
@given(rows=Rows, protocol=st.integers(2, 4), kind=st.sampled_from(["<i8", ">i4", "<u2", "|u1"]))
def test_ragged_rows_come_back(fakes: ModuleType, rows: list[list[int]], protocol: int, kind: str) -> None:
    rows = [[value % 100 if kind != "<i8" else value for value in row] for row in rows]
    held = fakes.ragged(rows)
    for place, row in enumerate(rows):
        held[place] = np.array(row, dtype=kind)
    read = parse_npy(fakes.pickled(held, protocol), "gt.npy").rows()
    assert [row.tolist() for row in read] == rows
    assert all(row.dtype == np.int64 for row in read)


@given(rows=Rows)
def test_as_numpy_saves_it(fakes: ModuleType, rows: list[list[int]]) -> None:
    assert [row.tolist() for row in parse_npy(saved(fakes.ragged(rows)), "x").rows()] == rows


def test_lists_numbers_and_scalars_are_rows_too() -> None:
    held = np.empty(4, dtype=object)
    held[0], held[1], held[2], held[3] = [1, 2], 3, np.int64(4), np.array([5, 6], dtype=object)
    assert [row.tolist() for row in parse_npy(saved(held), "x").rows()] == [[1, 2], [3], [4], [5, 6]]
    assert [row.tolist() for row in parse_npy(saved(np.array([7, 8])), "x").rows()] == [[7], [8]]
    assert [row.tolist() for row in parse_npy(saved(np.array([[1, 2], [3, 4]])), "x").rows()] == [
        [1, 2],
        [3, 4],
    ]
    turned = np.asfortranarray(np.array([[1, 2], [3, 4]]))
    assert [row.tolist() for row in parse_npy(saved(turned), "x").rows()] == [[1, 2], [3, 4]]


@settings(max_examples=60)
@given(texts=st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)))
def test_texts_come_back(texts: list[str]) -> None:
    if texts:
        assert parse_npy(saved(np.array(texts)), "x").texts() == texts
    held = np.empty(len(texts), dtype=object)
    held[:] = texts
    assert parse_npy(saved(held), "x").texts() == texts


def test_bytes_are_texts_and_numbers_numbers(tmp_path: Path) -> None:
    assert parse_npy(saved(np.array([b"a.jpg", b"b.jpg"])), "x").texts() == ["a.jpg", "b.jpg"]
    assert parse_npy(saved(np.array(25.0)), "x").numbers().tolist() == 25.0
    for wrong in (np.array([1.5]), np.array(["a"]), fakes_of_texts()):
        with pytest.raises(BenchmarkError, match="rows of references"):
            parse_npy(saved(wrong), "x").rows()
    with pytest.raises(BenchmarkError, match="names of photos"):
        parse_npy(saved(np.array([1])), "x").texts()
    for wrong in (np.array(["a"]), fakes_of_texts()):
        with pytest.raises(BenchmarkError, match="should hold numbers"):
            parse_npy(saved(wrong), "x").numbers()
    with pytest.raises(BenchmarkError, match=r"none\.npy cannot be read"):
        read_npy(tmp_path / "none.npy")


def fakes_of_texts() -> np.ndarray[Any, Any]:
    held = np.empty(1, dtype=object)
    held[0] = "a.jpg"
    return held


def test_nothing_in_a_file_is_run(tmp_path: Path, fakes: ModuleType) -> None:
    path, marker = fakes.malicious_npy(tmp_path / "x_gt.npy", tmp_path / "ran"), tmp_path / "ran"
    with pytest.raises(BenchmarkError, match="nothing of it was run"):
        read_npy(path)
    assert not marker.exists()
    np.load(path, allow_pickle=True)  # so that the test above means something
    assert marker.exists()


def test_one_list_that_is_named_a_million_times_is_looked_through_once(fakes: ModuleType) -> None:
    """A hundred kilobytes that would take hours: 200,000 numbers, looked through 50,000 times."""
    held = np.empty(50_000, dtype=object)
    held.fill(list(range(200_000)))
    with pytest.raises(BenchmarkError, match="holds more than 134217728 numbers"):
        parse_npy(saved(held), "x").rows()


def test_sides_beyond_all_numbers_are_refused() -> None:
    for shape in ("(0, " + "9" * 18 + ", " + "9" * 18 + ")", "(" + "9" * 18 + ",)", "(" + "2, " * 31 + ")"):
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
        with pytest.raises(BenchmarkError, match=r"ends before its|not a whole"):
            parse_npy(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(64), "x")


GLOBALS = [
    "os\nsystem",
    "builtins\neval",
    "numpy\nload",
    "numpy.core.multiarray\nscalar.x",
    "subprocess\nPopen",
]


@pytest.mark.parametrize("named", GLOBALS)
def test_functions_are_not_looked_up(named: str, fakes: ModuleType) -> None:
    program = b"\x80\x02c" + named.encode() + b"\n(X\x04\x00\x00\x00trueR."
    with pytest.raises(BenchmarkError, match="names"):
        parse_npy(fakes.pickled(np.empty(1, dtype=object), 2)[:128] + program, "x")


@pytest.mark.parametrize(
    "program",
    [
        b"\x80\x02].",  # a list, no array
        b"\x80\x02]q\x01h\x01a.",  # a list in itself
        b"\x80\x02r\xff\xff\xff\x7f.",  # remembers what is not there, at a place far out
        b"\x80\x02K\x01r\xff\xff\xff\x7f0.",
        b"\x80\x02K\x01a.",  # adds to a number
        b"\x80\x02t.",  # a row that never began
        b"\x80\x02K\x01)R.",  # calls a number
        b"\x80\x02K\x01)b.",  # changes a number
        b"\x80\x02ccollections\nOrderedDict\n)R.",
        b"\x80\x02}.",  # a dictionary
        b"\x80\x02(i__main__\nx\n.",
        b"\x80\x02h\x05.",
        b"\x80\x02",
        b"",
    ],
)
def test_odd_programs_are_refused(program: bytes, fakes: ModuleType) -> None:
    start = fakes.pickled(np.empty(1, dtype=object), 2)[:128]
    with pytest.raises(BenchmarkError, match="x is damaged"):
        parse_npy(start + program, "x")


def inner(fakes: ModuleType, change: Callable[[bytes], bytes]) -> bytes:
    data = fakes.pickled(fakes.ragged([[1, 2, 3]]), 3)
    changed = change(data)
    assert changed != data
    return changed


def test_arrays_that_make_no_sense(fakes: ModuleType) -> None:
    changes: list[Callable[[bytes], bytes]] = [
        lambda data: data.replace(b"i8", b"V8"),
        lambda data: data.replace(b"_reconstruct", b"scalar"),
        lambda data: data.replace(b"K\x03\x85", b"K\x09\x85"),  # a shape that its bytes do not fill
    ]
    for change in changes:
        with pytest.raises(BenchmarkError):
            parse_npy(inner(fakes, change), "x")
    with pytest.raises(BenchmarkError, match="says it holds"):
        parse_npy(inner(fakes, lambda data: data.replace(b"(1,)", b"(2,)")), "x")


def test_bytes_told_once_cannot_be_made_many(fakes: ModuleType) -> None:
    text = b"a" * 60
    named = b"c_codecs\nencode\nq\x01X" + struct.pack("<I", 60) + text + b"q\x02X\x06\x00\x00\x00latin1q\x03"
    again = b"0h\x01h\x02h\x03\x86R" * 40
    start = fakes.pickled(np.empty(1, dtype=object), 2)[:128]
    with pytest.raises(BenchmarkError, match="repeats itself"):
        parse_npy(start + b"\x80\x02" + named + again.replace(b"0h", b"h") + b".", "x")
    utf = named.replace(b"latin1", b"utf_16") + b"h\x01h\x02h\x03\x86R."
    with pytest.raises(BenchmarkError, match="codes bytes"):
        parse_npy(start + b"\x80\x02" + utf, "x")


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("{'descr': '<i8', 'fortran_order': False, 'shape': (900000000000,), }", "ends before"),
        ("{'descr': '<U0', 'fortran_order': False, 'shape': (900000000000,), }", "kind '<U0'"),
        ("{'descr': '<M8[s]', 'fortran_order': False, 'shape': (1,), }", "kind '<M8"),
        ("{'descr': [('a', '<i8')], 'fortran_order': False, 'shape': (1,), }", "not a whole"),
        ("{'descr': __import__('os'), 'fortran_order': False, 'shape': (1,), }", "not a whole"),
    ],
)
def test_headers_are_not_believed(header: str, says: str) -> None:
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(64)
    with pytest.raises(BenchmarkError, match=says):
        parse_npy(data, "x")


def test_headers_of_version_two_and_of_python_two() -> None:
    header = b"{'descr': '<i8', 'fortran_order': False, 'shape': (2L,), }\n"
    data = b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header + struct.pack("<qq", 5, 6)
    assert [row.tolist() for row in parse_npy(data, "x").rows()] == [[5], [6]]


def test_bytes_as_python_two_wrote_them(fakes: ModuleType) -> None:
    data = inner(fakes, lambda data: data.replace(b"C\x18", b"U\x18"))
    assert [row.tolist() for row in parse_npy(data, "x").rows()] == [[1, 2, 3]]


def test_an_array_of_more_than_integers_is_no_row(fakes: ModuleType) -> None:
    held = np.empty(1, dtype=object)
    for item in (
        [1, "a"],
        2.5,
        np.array([[1], "a"], dtype=object),
        {"a": 1},
        None,
        np.array([{}], dtype=object),
    ):
        held[0] = item
        with pytest.raises(BenchmarkError, match="x is damaged"):
            parse_npy(saved(held), "x").rows()
    for item in ([1, 2**70], 2**70, np.array([True]), "a"):
        held[0] = item
        with pytest.raises(BenchmarkError, match="rows of references"):
            parse_npy(saved(held), "x").rows()


def test_letters_that_do_not_exist() -> None:
    data = saved(np.array(["a"])).replace(b"a\0\0\0", b"\xff\xff\xff\x7f")
    with pytest.raises(BenchmarkError, match="letters that do not exist"):
        parse_npy(data, "x").texts()
    held = np.empty(1, dtype=object)
    held[0] = "\ud800"  # half a letter
    with pytest.raises(BenchmarkError, match="letters that do not exist"):
        parse_npy(saved(held), "x").texts()


def test_too_many_numbers(monkeypatch: pytest.MonkeyPatch, fakes: ModuleType) -> None:
    data = fakes.pickled(fakes.ragged([[1, 2], [3]]), 3)
    monkeypatch.setattr(safe_numpy, "MOST", 2)
    with pytest.raises(BenchmarkError, match="more than 2 numbers"):
        parse_npy(data, "x").rows()
    monkeypatch.setattr(safe_numpy, "MOST", 1)
    with pytest.raises(BenchmarkError, match="too many"):
        parse_npy(saved(np.arange(3)), "x")


def told(call: Callable[[], Any]) -> Any:
    """What a call gives, or the sentence it refuses with; anything else goes through."""
    try:
        return call()
    except BenchmarkError as error:
        return str(error)


def mutated(data: bytes, edits: list[tuple[int, int]], cut: int) -> bytes:
    held = bytearray(data)
    for place, value in edits:
        held[place % len(held)] = value
    return bytes(held[: len(held) - cut % len(held)])


Edits = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=5)


@settings(max_examples=400)
@given(which=st.integers(0, 4), edits=Edits, cut=st.one_of(st.just(0), st.integers(0, 300)))
@example(which=0, edits=[(200, 0x72)], cut=0)
def test_damage_is_a_sentence(fakes: ModuleType, which: int, edits: list[tuple[int, int]], cut: int) -> None:
    rows = fakes.ragged([[1, 2, 3], [], [70000]])
    whole = [
        fakes.pickled(rows, 2),
        fakes.pickled(rows, 4),
        saved(rows),
        saved(np.array(["a.jpg", "ü.jpg"])),
        saved(np.array([[1.0, 2.0]])),
    ][which]
    data = mutated(whole, edits, cut)
    for ask in ("rows", "texts", "numbers"):
        read = told(lambda: getattr(parse_npy(data, "gt.npy"), ask)())  # noqa: B023  # called here and now
        if isinstance(read, str):
            assert "gt.npy" in read
        elif ask != "numbers":
            assert len(read) <= len(whole)


@settings(max_examples=100)
@given(data=st.binary(max_size=200))
def test_any_bytes(data: bytes, fakes: ModuleType) -> None:
    start = fakes.pickled(np.empty(1, dtype=object), 2)[:128]
    for whole in (data, start + data):
        with pytest.raises(BenchmarkError):
            parse_npy(whole, "x").rows()


class TestZipped:
    def test_arrays_by_name(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", utmQ=np.array([[1.0, 2.0]]), names=np.array(["a"]))
        read = read_npz(tmp_path / "a.npz")
        assert read["utmQ"].numbers().tolist() == [[1.0, 2.0]]
        assert read["names"].texts() == ["a"]

    def test_a_pickle_inside_is_not_run(self, tmp_path: Path, fakes: ModuleType) -> None:
        marker = tmp_path / "ran"
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("x.npy", fakes.malicious_npy(tmp_path / "x.npy", marker).read_bytes())
        with pytest.raises(BenchmarkError, match=r"x\.npy in .*a\.npz .*nothing of it was run"):
            read_npz(tmp_path / "a.npz")
        assert not marker.exists()

    def test_too_large(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        np.savez(tmp_path / "a.npz", a=np.zeros(50))
        monkeypatch.setattr(safe_numpy, "_MOST_BYTES", 100)
        with pytest.raises(BenchmarkError, match="unpacks to more"):
            read_npz(tmp_path / "a.npz")

    def test_packed_otherwise_than_numpy_packs(self, tmp_path: Path) -> None:
        """LZMA, for one, has each file say how much memory it wants."""
        with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_LZMA) as archive:
            archive.writestr("a.npy", saved(np.zeros(5)))
        with pytest.raises(BenchmarkError, match="packed in a way that numpy never packs"):
            read_npz(tmp_path / "a.npz")

    def test_a_list_of_contents_without_end(self, tmp_path: Path) -> None:
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            for number in range(20_000):
                archive.writestr(f"{number}.txt", b"")
        with pytest.raises(BenchmarkError, match="lists more than a few arrays"):
            read_npz(tmp_path / "a.npz")

    @pytest.mark.skipif(os.name != "posix", reason="pipes and files of holes are POSIX's")
    def test_what_is_no_file_and_what_is_full_of_holes(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        (tmp_path / "holes").touch()
        os.truncate(tmp_path / "holes", 1 << 40)
        for read, name in itertools.product((read_npy, read_npz), ("pipe", "holes")):
            with pytest.raises(BenchmarkError, match=r"no regular file|longer than|not a whole \.npz"):
                read(tmp_path / name)

    @settings(max_examples=100)
    @given(edits=Edits, cut=st.one_of(st.just(0), st.integers(0, 300)))
    def test_damage(self, tmp_path_factory: pytest.TempPathFactory, edits: list[tuple[int, int]], cut: int) -> None:
        file = io.BytesIO()
        np.savez_compressed(file, utmQ=np.arange(30.0), names=np.array(["a", "b"]))
        path = tmp_path_factory.mktemp("z") / "a.npz"
        path.write_bytes(mutated(file.getvalue(), edits, cut))
        read = told(lambda: read_npz(path))
        assert "a.npz" in read if isinstance(read, str) else edits or set(read) == {"utmQ", "names"}


def test_pickles_own_reader_would_have_run_it(tmp_path: Path, fakes: ModuleType) -> None:
    marker = tmp_path / "ran"
    pickle.loads(pickle.dumps(fakes.Bomb(marker)))
    assert marker.exists()
