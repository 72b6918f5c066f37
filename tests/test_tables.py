"""What is written to a table comes back from it, whatever the values hold, and from any other reader of CSV."""

from __future__ import annotations

import csv
import io
import math
import os
import tempfile
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from salad import tables
from salad.errors import MissingExtraError
from salad.tables import (
    LONGEST_LINE,
    LONGEST_TEXT,
    CsvError,
    csv_line,
    number,
    read_csv,
    read_lines,
    read_parquet,
    shown,
    whole,
    without_formulas,
    write_table,
)

# a field of nothing and a line of one such field are written alike, and read as no line
LINES = st.lists(st.lists(st.text(st.characters(exclude_categories=["Cs"])), min_size=2), max_size=4)
NAMES = {"path": str, "lat": float}
PATH = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)
PATHS = st.lists(st.tuples(PATH, st.floats(-90, 90) | st.none()))


@given(LINES)
@example([["a\rb", "\r"], ["\n", "\r\n"], ['"', ","]])
def test_lines_come_back_as_they_were_written(lines: list[list[str]]) -> None:
    text = "".join(map(csv_line, lines))
    assert list(csv.reader(io.StringIO(text, newline=""), strict=True)) == lines


def test_a_line_ends_as_unix_ends_it_and_nothing_known_is_an_empty_field() -> None:
    assert csv_line(["a", None, 1.5, ""]) == "a,,1.5,\n"
    assert csv_line(["its last is\r\n"]) == '"its last is\r\n"\n'


@given(PATHS)
def test_a_table_comes_back_as_csv(rows: list[tuple[str, float | None]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "t.csv")
        with write_table(path, NAMES) as write:
            for row in rows:  # in as many parts as one likes
                write([dict(zip(NAMES, row, strict=True))])
        read = [(fields["path"], fields["lat"]) for _, fields in read_csv(path)]
    assert read == [(name, "" if lat is None else str(lat)) for name, lat in rows]


@settings(max_examples=20, deadline=None)  # a process looks at each first
@given(PATHS)
def test_a_table_comes_back_as_parquet(rows: list[tuple[str, float | None]]) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "t.parquet")
        with write_table(path, NAMES) as write:
            write([dict(zip(NAMES, row, strict=True)) for row in rows])
        read = list(read_parquet(path))
    assert [number for number, _ in read] == list(range(1, len(rows) + 1))
    assert [(fields["path"], fields["lat"]) for _, fields in read] == rows


def test_names_that_are_no_text_are_kept_by_csv_alone(tmp_path: Path) -> None:
    name = b"caf\xe9.jpg".decode("utf-8", "surrogateescape")
    with write_table(tmp_path / "t.csv", {"path": str}) as write:
        write([{"path": name}])
    assert [fields["path"] for _, fields in read_csv(tmp_path / "t.csv", errors="surrogateescape")] == [name]
    with pytest.raises(UnicodeDecodeError):
        list(read_csv(tmp_path / "t.csv"))
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    with pytest.raises(UnicodeEncodeError), write_table(tmp_path / "t.parquet", {"path": str}) as write:
        write([{"path": name}])


# --- numbers, and what a sentence tells of a value -------------------------------------------


@pytest.mark.parametrize("text", ["48.1", "-7", "+3", ".5", "5.", "1e-05", "-1.5E+3", "0", " 1", "2\t", "1e+16"])
def test_numbers_are_what_people_and_programs_write(text: str) -> None:
    assert number(text) == float(text)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_that_is_written_comes_back(value: float) -> None:
    assert number(str(value)) == number(repr(value)) == value


# Most of these are numbers to Python.
NO_NUMBERS = (
    *("1_0", "\uff11\uff12", "\u0661", "nan", "inf", "-Infinity", "1e400", "1\n", "\u20071", "9" * 100, "1e99999"),
    *("", " ", "0x10", "1,5", "1 2", "--1", "e5", ".", "True", "1" * 10**6),
)


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_nothing_else_is_a_number(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no number$") as told:
        number(text)
    assert len(str(told.value)) < 100
    with pytest.raises(ValueError, match=r"is no whole number$"):
        whole(text)


def test_whole_numbers() -> None:
    assert [whole(text) for text in ("7", "-12", "+1", " 3 ", "007")] == [7, -12, 1, 3, 7]
    for text in ("1.0", "1e3", "9" * 19):
        with pytest.raises(ValueError, match="no whole number"):
            whole(text)


@given(st.text() | st.binary() | st.integers() | st.lists(st.text()))
def test_a_value_is_told_in_a_few_letters_that_can_be_seen(value: object) -> None:
    told = shown(value)
    assert len(told) <= 65 + 3 * 200  # escapes are longer than what they stand for
    assert "\n" not in told
    assert "\x1b" not in told
    if len(repr(value)) <= 60:
        assert told == repr(value)


# --- files that are none, and lines without end ------------------------------------------------


def test_a_line_without_end_is_not_read_to_it(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for text in ("a,b\n1," + "x" * LONGEST_LINE, "a" * (LONGEST_LINE + 1), 'a\n"' + "b," * LONGEST_LINE):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(CsvError, match=r"line [12] has over 1,048,576 letters"):
            list(read_csv(path))
    path.write_text('a\n"' + "b\n" * LONGEST_LINE, encoding="utf-8")  # one value of a million lines
    with pytest.raises(CsvError, match="field larger than field limit"):
        list(read_csv(path))


@pytest.mark.skipif(os.name != "posix", reason="pipes, devices and files of holes are POSIX's")
@pytest.mark.parametrize("reader", [read_csv, read_parquet])
def test_what_is_no_file_is_not_waited_for(tmp_path: Path, reader: Any) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match="it is "):
            list(reader(path))
    (tmp_path / "holes").touch()
    os.truncate(tmp_path / "holes", 1 << 40)
    with pytest.raises((CsvError, ValueError)):
        list(reader(tmp_path / "holes"))


@given(st.binary(max_size=200))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    with suppress(CsvError, UnicodeDecodeError):
        for _, fields in read_csv(path):
            assert all(isinstance(value, str) for name, value in fields.items() if name is not None)


def test_lines_of_a_text(tmp_path: Path) -> None:
    path = tmp_path / "list.txt"
    path.write_bytes(b"\xef\xbb\xbfa\r\nb\n\nc")
    assert [line.strip() for line in read_lines(path)] == ["a", "b", "", "c"]
    with pytest.raises(ValueError, match="line 1 has over 1 letters"):
        list(read_lines(path, longest=1))


# --- Parquet that unpacks to what no table holds -----------------------------------------------


@pytest.fixture
def arrow() -> Any:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    return import_module("pyarrow")


def bombs(arrow: Any) -> dict[str, Any]:
    """Tables that take kilobytes on disk and gigabytes in memory, and what is said of each."""
    long, zeros = "x" * (LONGEST_TEXT + 1), np.zeros(20_000, dtype=np.int32)
    deep = arrow.array([[[1]] * 9] * 3)
    return {
        "20,000 rows in": arrow.table({"path": arrow.DictionaryArray.from_arrays(zeros, [long])}),
        "a text of 65,537 bytes": arrow.table({"path": [long] * 9}),
        "neither texts nor numbers": arrow.table({"path": ["a"] * 3, "lat": deep}),
        "'lat' holds": arrow.table({"path": ["a"], "lat": arrow.array([b"1" * 70_000], arrow.binary(70_000))}),
    }


def test_parquet_that_fills_the_memory_is_refused(tmp_path: Path, arrow: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet = import_module("pyarrow.parquet")
    for said, table in bombs(arrow).items():
        parquet.write_table(table, tmp_path / "t.parquet", compression="zstd")
        with pytest.raises(ValueError, match=said):
            list(read_parquet(tmp_path / "t.parquet"))
    monkeypatch.setattr(tables, "_MOST_OF_A_COLUMN", 1000)
    parquet.write_table(arrow.table({"path": [f"{n}" for n in range(999)]}), tmp_path / "t.parquet")
    with pytest.raises(ValueError, match="a column of it unpacks to more"):
        list(read_parquet(tmp_path / "t.parquet"))


def test_only_the_columns_that_are_wanted_are_read(tmp_path: Path, arrow: Any) -> None:
    parquet = import_module("pyarrow.parquet")
    odd = arrow.table({"Path": ["a", "b"], "deep": [[[1]], [[2]]], "lat": [1.5, None]})
    parquet.write_table(odd, tmp_path / "t.parquet")
    lower = partial(map, str.lower)
    rows = list(read_parquet(tmp_path / "t.parquet", lambda names: list(lower(names)), wanted=("path", "lat")))
    assert rows == [(1, {"path": "a", "lat": 1.5}), (2, {"path": "b", "lat": None})]


@settings(max_examples=20, deadline=None)
@given(where=st.integers(0, 2000), byte=st.integers(0, 255), cut=st.none() | st.integers(0, 2000))
def test_changed_parquet_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, where: int, byte: int, cut: int | None
) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    path = tmp_path_factory.getbasetemp() / "changed.parquet"
    with write_table(path, NAMES) as write:
        write([{"path": f"{number}.jpg", "lat": number / 7} for number in range(20)])
    content = bytearray(path.read_bytes())
    content[where % len(content)] = byte
    path.write_bytes(content if cut is None else content[:cut])
    with suppress(ValueError):
        for _, row in read_parquet(path):
            assert row.keys() <= {"path", "lat"} or where > 0


# --- columns -----------------------------------------------------------------------------------


@pytest.mark.parametrize("reader", [read_csv, read_parquet])
def test_the_header_says_what_columns_are_called_or_refuses_them(tmp_path: Path, reader: Any) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    path = tmp_path / ("t.csv" if reader is read_csv else "t.parquet")
    with write_table(path, {" Path": str, "lat": float}) as write:
        write([{" Path": "a", "lat": 1.5}])
    ((_, fields),) = reader(path, lambda names: [name.strip().lower() for name in names])
    assert (fields["path"], float(fields["lat"])) == ("a", 1.5)

    def refuse(names: list[str]) -> list[str]:
        raise KeyError(*names)

    with pytest.raises(KeyError, match="Path"):
        list(reader(path, refuse))


def test_lines_are_numbered_as_an_editor_does_and_need_not_be_of_one_length(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(b'\xef\xbb\xbfa,b\r\n\r\n1\r\n"x\ny",2,3,4\r\n')
    assert list(read_csv(path)) == [(3, {"a": "1", "b": ""}), (5, {"a": "x\ny", "b": "2", None: ["3", "4"]})]
    assert next(read_csv(path, missing=None))[1] == {"a": "1", "b": None}


def test_quotes_that_never_close(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text('a,b\n"1,2\n')
    with pytest.raises(CsvError):
        list(read_csv(path))
    assert [fields["a"] for _, fields in read_csv(path, strict=False)] == ["1,2\n"]


def test_what_is_no_parquet_and_what_is_not_there(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    (tmp_path / "t.parquet").write_bytes(b"PAR1 or not")
    with pytest.raises(ValueError, match="no Parquet"):
        list(read_parquet(tmp_path / "t.parquet"))
    for reader, name in ((read_csv, "gone.csv"), (read_parquet, "gone.parquet")):
        with pytest.raises(OSError, match="gone"):
            list(reader(tmp_path / name))


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match="parquet"), write_table(tmp_path / "t.parquet", NAMES):
        pass
    with pytest.raises(MissingExtraError, match="parquet"):
        list(read_parquet(tmp_path / "t.parquet"))


FORMULAS = st.text("=+-@\t\r\na0.e5", max_size=6)


@given(text=FORMULAS, number=st.floats(allow_nan=False, allow_infinity=False) | st.integers())
def test_nothing_for_a_spreadsheet_begins_like_a_formula_but_numbers(text: str, number: float) -> None:
    word, path, none, *numbers = without_formulas([text, PurePosixPath("a", text), None, number, str(number)])
    assert numbers == [number, str(number)]
    assert (none, path) == (None, PurePosixPath("a", text))
    if str(word)[:1] in set("=+-@\t\r\n"):
        assert math.isfinite(float(word))
    assert word in (text, f"'{text}")


@given(text=FORMULAS.filter(bool))
def test_a_path_in_a_spreadsheet_is_the_same_path(text: str) -> None:
    (shown,) = without_formulas([PurePosixPath(text)])
    assert str(shown)[0] not in "=+-@\t\r\n"
    assert PurePosixPath(shown) == PurePosixPath(text)


def test_parquet_that_ends_whoever_looks_at_it_is_refused(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    parquet = import_module("pyarrow.parquet")
    path = tmp_path / "t.parquet"
    parquet.write_table(arrow.table({"path": ["a.jpg", None]}), path)
    assert [fields for _, fields in read_parquet(path)] == [{"path": "a.jpg"}, {"path": None}]
    # The column is called one that has no gaps, against what is counted of it.
    gaps = b"\x25\x02"
    data = path.read_bytes()
    at = data.rindex(gaps, 0, data.rindex(b"path"))
    path.write_bytes(data[:at] + b"\x25\x00" + data[at + 2 :])
    with pytest.raises(ValueError, match="what it says of its columns is damaged"):
        list(read_parquet(path))
