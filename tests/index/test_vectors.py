"""The rows of a matrix file: read where they lie, whatever happens to the file."""

import errno
import io
import os
import threading
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.errors import StoreError
from salad.index import vectors
from salad.index.vectors import FileRows, NpyWriter, append, storable, sums

DIM = 6


def drawn(rows: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, DIM)).astype(np.float16)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "descriptors.f16"
    path.write_bytes(drawn(20).tobytes())
    return path


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(0, 12),
    spare=st.integers(0, 30),
    numbers=st.integers(1, 40),
    start=st.integers(0, 14),
    count=st.integers(0, 14),
    data=st.data(),
)
def test_what_is_read_is_what_was_written(
    rows: int, spare: int, numbers: int, start: int, count: int, data: st.DataObject
) -> None:
    written = drawn(rows)
    with TemporaryDirectory() as folder:
        path = Path(folder, "m")
        path.write_bytes(written.tobytes() + b"\xff" * spare)  # an interrupted add leaves more than counts
        held = FileRows(path, rows=rows, dim=DIM)
        assert (held.rows, held.held) == (rows, rows)
        out = np.full((count, DIM), np.nan, np.float16)
        got = held.read(start, out)
        assert got == len(written[start : start + count])
        assert np.array_equal(out[:got], written[start : start + got])
        assert np.isnan(out[got:]).all()
        if rows:
            wanted = data.draw(st.lists(st.integers(0, rows - 1), max_size=20))
            assert np.array_equal(held.take(wanted), written[wanted])
        blocks = [(first, block.copy()) for first, block in held.blocks(numbers=numbers)]
        assert [first for first, _ in blocks] == list(range(0, rows, max(1, numbers // DIM)))
        assert np.array_equal(np.concatenate([np.zeros((0, DIM)), *(b for _, b in blocks)]), written)
        held.close()


def test_no_rows_are_no_rows(file: Path) -> None:
    held = FileRows(file, rows=0, dim=DIM)
    assert held.take([]).shape == (0, DIM)
    assert list(held.blocks()) == []


def test_a_truncated_file_holds_fewer(file: Path) -> None:
    os.truncate(file, 15 * DIM * 2 + 3)
    held = FileRows(file, rows=20, dim=DIM)
    assert (held.rows, held.held) == (20, 15)
    assert np.array_equal(held.take(range(15)), drawn(20)[:15])
    for beyond in ([14, 15], [3, -1], [99]):
        with pytest.raises(StoreError, match=r"truncated .it holds 15 descriptors, 20 were committed"):
            held.take(beyond)


def test_a_file_cut_short_while_open_gives_what_is_left(file: Path) -> None:
    held = FileRows(file, rows=20, dim=DIM)
    os.truncate(file, 4 * DIM * 2 + 1)
    assert held.read(0, np.empty((20, DIM), np.float16)) == 4
    assert [len(block) for _, block in held.blocks(numbers=3 * DIM)] == [3, 1, 0, 0, 0, 0, 0]


def test_rows_stay_what_they_are_when_the_file_is_replaced(file: Path) -> None:
    held = FileRows(file, rows=20, dim=DIM)
    other = file.with_name("other")
    other.write_bytes(drawn(20, seed=1).tobytes())
    other.replace(file)
    assert np.array_equal(held.take(range(20)), drawn(20))


def test_reads_that_stop_short_go_on(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = os.preadv
    monkeypatch.setattr(os, "preadv", lambda number, parts, at: whole(number, [parts[0][:5]], at))
    assert np.array_equal(FileRows(file, rows=20, dim=DIM).take(range(20)), drawn(20))


def test_systems_without_preadv_read_the_same_from_any_thread(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "preadv")
    held, wrong = FileRows(file, rows=20, dim=DIM), []

    def look(row: int) -> None:
        for _ in range(200):
            if not np.array_equal(held.take([row])[0], drawn(20)[row]):
                wrong.append(row)

    threads = [threading.Thread(target=look, args=(row,)) for row in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_file_that_cannot_be_read_is_a_sentence(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError, match="none is missing: restore it"):
        FileRows(file.with_name("none"), rows=1, dim=DIM)
    with pytest.raises(StoreError, match=r"cannot be read .*check its permissions"):
        FileRows(file.parent, rows=1, dim=DIM)

    def failing(*_: object) -> int:
        raise OSError(errno.EIO, "Input/output error")

    held = FileRows(file, rows=20, dim=DIM)
    monkeypatch.setattr(os, "preadv", failing, raising=False)
    with pytest.raises(StoreError, match=r"cannot be read .Input/output error\): check the disk"):
        held.take([1])


@pytest.mark.parametrize("room", [0, 20 * DIM])
def test_blocks_are_the_same_kept_or_not(file: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    monkeypatch.setattr(vectors, "_KEEP", room)
    held, spare = FileRows(file, rows=20, dim=DIM), np.empty((7, DIM), np.float16)
    for sweep in range(4):
        held.keep()
        for start, stop in ((0, 7), (5, 9), (14, 20)):
            assert np.array_equal(held.block(start, stop, spare), drawn(20)[start:stop])
        assert np.array_equal(held.take([3, 16, 0]), drawn(20)[[3, 16, 0]])
        assert np.array_equal(held.take([3, 10]), drawn(20)[[3, 10]])  # a row nobody swept
        if sweep == 2 and room:
            file.write_bytes(b"")  # the last sweep reads nothing
            with pytest.raises(StoreError, match="truncated"):
                held.take([10])
            monkeypatch.setattr(FileRows, "read", None)
            assert np.array_equal(held.block(5, 9, spare), drawn(20)[5:9])
            return
    assert not room


def test_kept_rows_end_where_the_file_was_cut(file: Path) -> None:
    held, spare = FileRows(file, rows=20, dim=DIM), np.empty((20, DIM), np.float16)
    os.truncate(file, 4 * DIM * 2 + 1)
    for _ in range(2):
        held.keep()
        assert np.array_equal(held.block(0, 20, spare), drawn(20)[:4])


def test_closed_rows_let_go_of_the_file(file: Path) -> None:
    held = FileRows(file, rows=20, dim=DIM)
    opened: io.FileIO = held._file
    held.close()
    held.close()
    assert opened.closed
    held = FileRows(file, rows=20, dim=DIM)
    opened = held._file
    del held
    assert opened.closed


# --- writing --------------------------------------------------------------------------------


def unit(rows: int, dim: int = DIM) -> np.ndarray:
    made = np.random.default_rng(rows).standard_normal((rows, dim))
    return made / np.linalg.norm(made, axis=1, keepdims=True)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("block", [1, 2 * DIM + 1, 1 << 20])
def test_descriptors_are_stored_as_the_nearest_half(dtype: type, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vectors, "_BLOCK", block)
    given = unit(9).astype(dtype)
    stored = storable(given, 9, DIM)
    assert stored.dtype == np.dtype("<f2")
    assert np.array_equal(stored, given.astype(np.float16))


@pytest.mark.parametrize("at", [0, 4, 8])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300, 1e30, 0.2])
def test_one_wrong_row_anywhere_is_refused(at: int, bad: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vectors, "_BLOCK", 2 * DIM)
    given = unit(9).astype(np.float64)  # which may hold what is infinite in float32
    given[at] *= bad
    with pytest.raises(StoreError, match="finite and of length 1"):
        storable(given, 9, DIM)


def test_sums_are_of_the_bytes_on_the_disk(file: Path) -> None:
    raw = file.read_bytes()
    parts = [raw[low : low + 2 * DIM] for low in range(0, len(raw), 2 * DIM)]
    assert sums(drawn(20)) == [zlib.crc32(part) for part in parts]
    assert sums(np.asfortranarray(drawn(20))) == sums(drawn(20))


def test_rows_are_written_behind_those_that_count(file: Path) -> None:
    append(file, drawn(3, seed=1), at=18)
    held = FileRows(file, rows=21, dim=DIM).take(range(21))
    assert np.array_equal(held, np.concatenate([drawn(20)[:18], drawn(3, seed=1)]))
    with pytest.raises(StoreError, match="nothing was added"):
        append(file.with_name("none"), drawn(1), at=0)


# --- files of other tools -------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["<f2", "<f4", "<f8", ">f2", ">f4", ">f8"])
def test_rows_of_another_tool_are_read_as_they_are(tmp_path: Path, kind: str) -> None:
    written, path = drawn(20).astype(kind), tmp_path / "a.npy"
    np.save(path, written)
    held = FileRows.of_npy(path)
    assert (len(held), held.dim, held.held, held.longest) == (20, DIM, 20, None)
    assert held.dtype == (np.float16 if kind.endswith("2") else np.float32)
    assert np.array_equal(held.block(3, 9, np.empty((6, DIM), held.dtype)), written[3:9])
    assert np.array_equal(held.take([19, 0, 1]), written[[19, 0, 1]])
    assert np.array_equal(np.concatenate([block.copy() for _, block in held.blocks(numbers=50)]), written)


def test_numbers_beyond_float32_are_infinite(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[1e300, 1.0]]))
    assert FileRows.of_npy(tmp_path / "a.npy").take([0]).tolist() == [[np.inf, 1.0]]


def test_rows_of_which_none_may_be_lost_say_so(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, drawn(20))
    held = FileRows.of_npy(path)
    os.truncate(path, path.stat().st_size - 3 * DIM * 2)
    with pytest.raises(StoreError, match="cut short while it was read"):
        held.block(10, 20, np.empty((10, DIM), np.float16))
    with pytest.raises(StoreError, match=r"is cut short \(it should hold 20 rows\)"):
        FileRows.of_npy(path)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_what_is_written_bit_by_bit_is_what_numpy_reads(tmp_path: Path, kind: type) -> None:
    with NpyWriter(tmp_path / "a.npy", dim=DIM, dtype=kind) as file:
        for some in np.array_split(drawn(20), 3):
            file.write(some)
    read = np.load(tmp_path / "a.npy", allow_pickle=False)
    assert (read.dtype, file.rows) == (kind, 20)
    assert np.array_equal(read, drawn(20))
