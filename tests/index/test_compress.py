"""Codes beside the matrix: kept up to date by all that changes an index, never trusted where they are damaged."""

from __future__ import annotations

import os
import re
import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.errors import StoreError
from salad.images.photo import Photo
from salad.index import codes as code_files
from salad.index import compress
from salad.index.index import Index
from salad.index.transfer import merge
from salad.search import compressed
from salad.search.exact import ExactSearcher

DIM, SIZE, BLOCK = 64, 48, 100  # a block of so many rows


def unit(numbers: range) -> np.ndarray:
    """Each number has its own row, along few directions more than along others."""
    wide = 0.9 ** np.arange(DIM)
    drawn = np.array([np.random.default_rng(number).standard_normal(DIM) * wide for number in numbers]).reshape(-1, DIM)
    return np.float32(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks, stages and indexes so small that a test sees many."""
    monkeypatch.setattr(compressed, "BLOCK", BLOCK * SIZE)
    monkeypatch.setattr(compressed, "_SPARE", 2)
    monkeypatch.setattr(compress, "_STAGE", 150)
    monkeypatch.setattr("salad.index.index.CODES_FROM", 300)
    monkeypatch.setattr("salad.index.index.CompressedSearcher", partial(compressed.CompressedSearcher, candidates=60))


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    """Of a thousand photos with codes."""
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as made:
        add(made, range(1000))
        made.compress(SIZE)
        yield made


def add(index: Index, numbers: range) -> None:
    names = [f"{number:032x}" for number in numbers]
    index.add([Photo(Path("/photos", name)) for name in names], unit(numbers), identities=names)


def code_file(index: Index) -> Path:
    (found,) = index.folder.glob("codes-*.i8")
    return found


def as_exact(index: Index, *, by_codes: bool = True) -> bool:
    """Whether searches find what exact ones find, by codes or not."""
    with Index.open(index.folder) as asked, Index.open(index.folder, searcher=ExactSearcher) as exact:
        assert (type(asked._seen()[2]) is compressed.CompressedSearcher) == by_codes
        return all(
            asked.search(unit(range(5000, 5040)), k=5, centred=centred)
            == exact.search(unit(range(5000, 5040)), k=5, centred=centred)
            for centred in (False, True, True)
        )


def test_codes_are_kept_up_to_date(index: Index, tmp_path: Path) -> None:
    assert index.info().coded == 1000
    assert as_exact(index)
    add(index, range(1000, 1333))
    index.remove([f"/photos/{number:032x}" for number in range(0, 600, 3)])
    assert index.info().coded == 1333
    assert as_exact(index)
    assert index.compact().kept == index.info().coded == 1133
    assert as_exact(index)
    with Index.create(tmp_path / "other", dim=DIM, fingerprint="f", model="m") as other:
        add(other, range(1300, 1400))
        merge(index, other)
    assert index.info().coded == 1200
    assert as_exact(index)
    assert index.verify() == []
    assert code_file(index).stat().st_size == 1200 * SIZE
    assert index.compact().kept == 1200  # nothing to gain: they stay
    assert index.info().coded == 1200


def test_an_open_index_sees_the_codes_of_others_and_keeps_what_it_read(index: Index) -> None:
    with Index.open(index.folder) as reader:
        for _ in range(3):
            reader.search(unit(range(2)))
        kept = reader._codes._kept.copy()  # type: ignore[union-attr]
        assert len(kept) == 10
        add(index, range(1000, 1010))
        reader.search(unit(range(2)))
        now = reader._codes._kept  # type: ignore[union-attr]
        assert len(now) == 11
        assert all(now[number] is kept[number] for number in range(10))  # those that did not grow
        index.compress(40)
        assert reader.info().code_bytes == 40
        assert [best[0].row for best in reader.search(unit(range(5)))] == [0, 1, 2, 3, 4]


def test_a_small_index_is_searched_exactly(tmp_path: Path) -> None:
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as made:
        add(made, range(200))
        made.compress(SIZE)
        assert as_exact(made, by_codes=False)


def test_info_tells_of_codes(index: Index) -> None:
    told = index.info().as_dict()
    assert {name: told[name] for name in ("bytes_of_codes", "code_bytes", "coded", "codes_fitted_on")} == {
        "bytes_of_codes": 1000 * SIZE,
        "code_bytes": SIZE,
        "coded": 1000,
        "codes_fitted_on": 1000,
    }
    index.drop_codes()
    assert not {"bytes_of_codes", "code_bytes", "coded", "codes_fitted_on"} & set(index.info().as_dict())


def flip(path: Path, place: int) -> None:
    raw = bytearray(path.read_bytes())
    raw[place] ^= 0x40
    path.write_bytes(raw)


DAMAGE: dict[str, tuple[Any, str]] = {
    "a bit": (lambda path: flip(path, 250 * SIZE + 7), "block 2 of .* is damaged"),
    "its end": (lambda path: os.truncate(path, 730 * SIZE + 5), "is cut short .it holds 730 codes of 1000"),
    "all of it": (lambda path: path.unlink(), "cannot be read"),
    "another's": (lambda path: path.write_bytes(bytes(1000 * SIZE)), "block 0 of .* is damaged"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_codes_are_noticed_passed_over_and_mended(index: Index, damage: str) -> None:
    strike, sentence = DAMAGE[damage]
    strike(code_file(index))
    whole = damage != "all of it"
    assert as_exact(index, by_codes=whole)
    with Index.open(index.folder) as struck:
        struck.search(unit(range(3)))
        assert any(f"'salad compress {index.folder}'" in said for said in struck.noticed)
        assert re.search(sentence, "\n".join(struck.noticed))
        assert set(struck.noticed) <= set(struck.verify())
        add(struck, range(1000, 1100))  # writers go on as before
        assert as_exact(struck, by_codes=whole)
        struck.compress()
    assert index.verify() == []
    assert index.info().coded == 1100
    assert as_exact(index)
    assert index.noticed == []


def test_how_rows_are_coded_is_held_to_its_checksum(index: Index) -> None:
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("UPDATE codings SET step = step * 2")
    db.close()
    assert as_exact(index, by_codes=False)
    with Index.open(index.folder) as struck:
        (said,) = struck.noticed
        assert "how " in said
        assert "is coded is damaged" in said
        assert struck.verify() == [said]
        struck.compress()
        assert struck.verify() == []
    assert as_exact(index)


def test_codes_of_other_descriptors_are_found_out(index: Index) -> None:
    """As no kill can leave them: with checksums of their own."""
    file = code_file(index)
    raw = np.frombuffer(file.read_bytes(), np.int8).reshape(-1, SIZE)
    file.write_bytes(raw[::-1].tobytes())
    sums = [code_files.zlib.crc32(raw[::-1][low : low + BLOCK].tobytes()) for low in range(0, 1000, BLOCK)]
    with sqlite3.connect(index.folder / "photos.sqlite") as db:
        db.execute("UPDATE codes SET sums = ?", (np.array(sums, "<u4").tobytes(),))
    db.close()
    with Index.open(index.folder) as struck:
        (said,) = struck.verify()
    assert "holds codes of other descriptors for 1000 photos" in said


def test_a_damaged_descriptor_is_no_fault_of_its_code(index: Index) -> None:
    flip(index.folder / "descriptors.f16", 7 * DIM * 2 + 1)
    (said,) = index.verify()
    assert "has a damaged descriptor" in said
    assert 7 not in {match.row for best in index.search(unit(range(20)), k=5) for match in best}


# --- an older salad ----------------------------------------------------------------------------


def test_what_an_older_salad_adds_is_searched_exactly(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as older:
        older.setattr("salad.index.index.extend", lambda *_, **__: None)
        add(index, range(1000, 1200))
    assert index.info().coded == 1000
    assert as_exact(index)
    assert index.verify() == []
    assert index.wants_codes()
    add(index, range(1200, 1210))  # there is no gap in codes
    assert index.info().coded == 1000
    done = index.compress()
    assert (done.fitted, done.written, done.rows) == (False, 210, 1210)
    assert as_exact(index)


def test_codes_that_an_older_salad_compacted_away_pass_for_none(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    index.remove([f"/photos/{number:032x}" for number in range(500)])
    with monkeypatch.context() as older:
        older.setattr(code_files, "carry", lambda *_, **__: None)
        index.compact()
    with Index.open(index.folder) as opened:
        (said,) = opened.noticed
        assert "holds codes of descriptors.f16, which is no more" in said
        assert opened.verify() == [said]
    assert as_exact(index, by_codes=False)
    assert index.wants_codes()
    assert index.compress().fitted
    assert as_exact(index)
    assert index.verify() == []


# --- when codes are made, and made anew --------------------------------------------------------


def test_an_index_wants_codes_once_it_is_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Index.create(tmp_path / "i", dim=DIM, fingerprint="f", model="m") as made:
        add(made, range(400))
        assert not made.wants_codes()
        monkeypatch.setattr(compress, "AUTOMATIC", 400 * DIM)
        assert made.wants_codes()
        assert made.compress().size == DIM  # of 256 bytes there is no use
        assert not made.wants_codes()
        made.drop_codes()
        assert not made.wants_codes()  # as was said
        add(made, range(400, 500))
        assert not made.wants_codes()
        assert made.compress(SIZE).size == SIZE
        assert not made.wants_codes()


def test_an_index_that_has_outgrown_its_codes_is_fitted_anew(index: Index) -> None:
    add(index, range(1000, 1999))
    assert not index.wants_codes()
    assert not index.compress().fitted
    add(index, range(1999, 2000))
    assert index.wants_codes()
    before = code_file(index)
    done = index.compress()
    assert (done.fitted, done.written, index.info().codes_fitted_on) == (True, 2000, 2000)
    assert not before.exists()
    assert not index.wants_codes()
    assert as_exact(index)


def test_the_old_codes_serve_until_the_new_are_done(index: Index) -> None:
    def interrupt(done: int, _: int) -> None:
        if done == 450:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        index.compress(32, progress=interrupt)
    assert (index.info().code_bytes, index.info().coded) == (SIZE, 1000)
    assert as_exact(index)
    add(index, range(1000, 1100))  # to both, or the new ones would end
    told: list[tuple[int, int]] = []
    done = index.compress(progress=lambda *far: told.append(far))
    assert (done.size, done.fitted, done.written) == (32, False, 650)  # behind those of before
    assert told[0] == (450, 1100)
    assert told[-1] == (1100, 1100)
    assert code_file(index).stat().st_size == 1100 * 32


def test_others_may_write_while_codes_are_made(index: Index) -> None:
    def meanwhile(done: int, _: int) -> None:
        with Index.open(index.folder, wait=0) as other:
            if done == 300:
                add(other, range(1000, 1100))
            if done == 600:
                other.remove([f"/photos/{number:032x}" for number in range(100)])
                other.compact()

    index.compress(32, progress=meanwhile)
    assert index.info().coded == len(index) == 1000
    assert index.info().code_bytes == 32
    assert index.verify() == []


def test_an_index_that_cannot_be_coded_says_so(index: Index) -> None:
    with pytest.raises(StoreError, match="codes of 0 bytes cannot be"):
        index.compress(0)
    os.truncate(index.folder / "descriptors.f16", 900 * DIM * 2)
    with Index.open(index.folder) as cut:
        with pytest.raises(StoreError, match=r"is truncated .*so no codes were made: restore it, or run"):
            cut.compress(32)
        assert not cut.wants_codes()
        assert {match.row for best in cut.search(unit(range(0, 1000, 50)), k=9) for match in best} <= set(range(900))
        assert cut.compact(dropping=len).kept == 900
        assert cut.info().coded == 900
    assert as_exact(index)


def test_leftovers_are_swept(index: Index) -> None:
    left, mine = index.folder / "codes-77.i8", index.folder / "codes-mine.i8"
    for file in (left, mine):
        file.write_bytes(b"x")
    index.compress()
    assert not left.exists()
    assert mine.exists()
