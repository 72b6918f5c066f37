"""What is written to a table comes back from it, whatever the values hold, and from any other reader of CSV."""

from __future__ import annotations

import csv
import io
import math
import tempfile
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from salad.errors import MissingExtraError
from salad.tables import CsvError, csv_line, read_csv, read_parquet, without_formulas, write_table

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
