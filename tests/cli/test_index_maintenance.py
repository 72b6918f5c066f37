"""`salad verify`, `compact`, `export` and `merge` from the shell."""

import os
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from salad.geo import GeoPoint
from salad.images.photo import Photo
from salad.index.index import Index
from salad.index.transfer import take


def one_sentence(ran: Any) -> str:
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("salad: ")
    assert len(ran.err.splitlines()) == 1
    return str(ran.err)


def matrix_of(city: Path) -> Path:
    (found,) = city.glob("descriptors*.f16")
    return found


def test_verify_judges_what_cannot_be_opened(cli: Any, city: Path) -> None:
    matrix_of(city).unlink()
    ran = cli("verify", city)
    assert (ran.code, len(ran.out.splitlines())) == (1, 1)
    assert "descriptors.f16 is missing: restore it" in ran.out
    (city / "photos.sqlite").write_bytes(b"no database" * 1000)
    ran = cli("verify", city)
    assert ran.code == 1
    assert "photos.sqlite is damaged" in ran.out


def test_verify_says_all_that_is_wrong(cli: Any, city: Path) -> None:
    with sqlite3.connect(city / "photos.sqlite") as db:
        db.execute("UPDATE photos SET lat = 99 WHERE row = 2")
    db.close()
    os.truncate(matrix_of(city), 512 * 4)
    ran = cli("verify", city)
    assert ran.code == 1
    words = ("the record of", "is truncated", "has lost its", "has lost its")
    assert all(word in line for word, line in zip(words, ran.out.splitlines(), strict=True))


def test_verify_names_what_a_truncated_index_lost_and_compact_mends_it(
    cli: Any, city: Path, photos: Any, asked: Any
) -> None:
    os.truncate(matrix_of(city), 5 * 512)
    lost = sorted(path.resolve() for path in photos.reference)
    ran = cli("verify", city)
    whole, photo = ran.out.splitlines()
    assert (ran.code, "is truncated: it holds 5 descriptors" in whole) == (1, True)
    (name,) = [path for path in lost if photo.startswith(f"{path} has lost its descriptor")]
    assert "salad compact" in one_sentence_of_index(cli, photos, city, name)
    before = {file.name: file.read_bytes() for file in city.iterdir()}
    assert f"1 photos of {city} are damaged ({name}), so nothing was changed" in one_sentence(cli("compact", city))
    assert {file.name: file.read_bytes() for file in city.iterdir()} == before
    ran = cli("compact", city, "--drop-damaged")
    assert (ran.code, ran.out) == (0, "")
    assert ran.err.splitlines()[0] == f"{name} is damaged and goes: index it again"
    assert "it holds 5 photos" in ran.err
    assert cli("index", photos.references, "--to", city).code == 0
    assert cli("verify", city).out == f"{city} is sound: 6 photos\n"


def one_sentence_of_index(cli: Any, photos: Any, city: Path, lost: Path) -> str:
    """What adding to a truncated index says."""
    new = city.parent / "new.jpg"
    new.write_bytes(photos.query[0].read_bytes())
    return one_sentence(cli("index", new, "--to", city))


def test_compact_gives_room_back(cli: Any, city: Path, photos: Any) -> None:
    cli("remove", photos.reference[0], photos.reference[1], "--index", city)
    assert cli("info", city, "--format", "json").json()["removed"] == 2
    ran = cli("compact", city)
    assert (ran.code, ran.out) == (0, "")
    assert "MB given back; it holds 4 photos" in ran.err
    assert cli("info", city, "--format", "json").json()["removed"] == 0
    assert matrix_of(city).stat().st_size == 4 * 512


@pytest.mark.parametrize("form", ["csv", "parquet", "geojson"])
def test_export_writes_a_folder_that_can_be_taken_back(cli: Any, city: Path, tmp_path: Path, form: str) -> None:
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    ran = cli("export", city, "--to", tmp_path / "out", "--format", form, "--dtype", "float32")
    assert (ran.code, ran.out) == (0, "")
    assert "6 photos written" in ran.err
    assert np.load(tmp_path / "out" / "descriptors.npy").dtype == np.float32
    with (
        Index.open(city) as old,
        Index.create(tmp_path / "back", dim=old.dim, fingerprint=old.fingerprint, model=old.model) as back,
    ):
        assert take(back, tmp_path / "out") == 6
        assert list(back.photos()) == list(old.photos())
    assert "already exists and is not empty" in one_sentence(cli("export", city, "--to", tmp_path / "out"))


def test_export_names_what_it_leaves_out(cli: Any, city: Path, tmp_path: Path) -> None:
    os.truncate(matrix_of(city), 5 * 512)
    ran = cli("export", city, "--to", tmp_path / "out")
    assert ran.code == 0
    assert "was left out, since its descriptor is damaged: index it again" in ran.err
    assert "5 photos written" in ran.err


def test_export_of_nothing_finds_nothing(cli: Any, city: Path, photos: Any, tmp_path: Path) -> None:
    cli("remove", photos.references, "--index", city)
    assert cli("export", city, "--to", tmp_path / "out").code == 1


def test_merge_takes_what_is_new(cli: Any, city: Path, photos: Any, tmp_path: Path, asked: Any) -> None:
    cli("index", photos.queries, photos.references, "--to", tmp_path / "other")
    with Index.open(city) as index:
        row = np.eye(1, index.dim, dtype=np.float32)
        index.add([Photo(photos.query[0], GeoPoint(1, 2))], row, identities=["another content"])
    ran = cli("merge", city, tmp_path / "other")
    assert (ran.code, ran.out) == (0, "")
    assert f"{photos.query[0].resolve()} was left out of {tmp_path / 'other'}" in ran.err
    assert "5 photos added, 6 there already" in ran.err
    assert f"{city}: it holds 12 photos" in ran.err
    assert "no other index is named" in one_sentence(cli("merge", city))
    with Index.open(city) as index:
        Index.create(tmp_path / "third", dim=index.dim, fingerprint="f", model="third").close()
    assert "take them into an index of their own" in one_sentence(cli("merge", city, tmp_path / "third"))


def test_compress_gives_codes_and_takes_them_away(cli: Any, city: Path, asked: Any) -> None:
    ran = cli("compress", city, "--bytes", "64")
    assert (ran.code, ran.out) == (0, "")
    assert "6 photos have codes of 64 bytes, fitted anew" in ran.err
    told = cli("info", city, "--format", "json").json()
    assert [told[name] for name in ("code_bytes", "coded", "codes_fitted_on", "bytes_of_codes")] == [64, 6, 6, 6 * 64]
    assert "bytes of codes a photo" in cli("info", city).out
    assert "6 photos have codes of 64 bytes, 0 of them written" in cli("compress", city).err
    assert cli("verify", city).code == 0
    (codes,) = city.glob("codes-*.i8")
    codes.write_bytes(b"torn")
    ran = cli("verify", city)
    assert ran.code == 1
    assert f"'salad compress {city.resolve()}'" in ran.out
    assert cli("compress", city).code == cli("verify", city).code == 0
    assert "all searches are exact" in cli("compress", city, "--off").err
    assert not list(city.glob("codes-*"))
    assert "leave out --bytes 64" in one_sentence(cli("compress", city, "--off", "--bytes", "64"))


def test_a_large_index_is_compressed_by_itself(cli: Any, city: Path, photos: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("salad.index.compress.AUTOMATIC", 1)
    ran = cli("index", photos.references, "--to", city)
    assert "6 photos have codes of 256 bytes, fitted anew" in ran.err
    assert "codes" not in cli("index", photos.references, "--to", city).err
    cli("compress", city, "--off")
    assert "codes" not in cli("index", photos.references, "--to", city).err


def test_locate_says_that_codes_are_damaged_and_searches_exactly(cli: Any, city: Path, photos: Any) -> None:
    plain = cli("locate", photos.queries, "--index", city, "--format", "json")
    cli("compress", city)
    for more in ((), ("--exact",)):
        assert cli("locate", photos.queries, "--index", city, "--format", "json", *more) == plain
    (codes,) = city.glob("codes-*.i8")
    codes.unlink()
    ran = cli("locate", photos.queries, "--index", city, "--format", "json")
    assert (ran.code, ran.out) == (plain.code, plain.out)
    assert f"'salad compress {city.resolve()}'" in ran.err
