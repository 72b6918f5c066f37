"""Out to other tools and back, from other tools, and one index into another: nothing lost, nothing twice."""

import csv
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from salad.errors import MissingExtraError, StoreError, WrongModelError
from salad.geo import GeoPoint
from salad.images.photo import Photo, content_hash
from salad.index.index import Index
from salad.index.photo_list import read, writer
from salad.index.transfer import Source, export, merge, model_of, take

DIM = 8
FORMS = ("csv", "geojson", *(["parquet"] if find_spec("pyarrow") else []))


def contents(letters: str) -> list[str]:
    """Content hashes, one a letter."""
    return [f"{ord(letter):032x}" for letter in letters]


def descriptors(count: int, seed: int = 0) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((count, DIM))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


def create(folder: Path, *, model: str = "fake") -> Index:
    return Index.create(folder, dim=DIM, fingerprint=f"print of {model}", model=model)


PHOTOS = [
    Photo(Path('/photos/東京駅, "east".jpg'), GeoPoint(35.681236, 139.767125), 90.5, datetime(2024, 5, 1, 12)),
    Photo(Path("/photos/شارع.jpg"), None, None, datetime(2024, 5, 1, 12, tzinfo=UTC)),
    Photo(Path("/photos/two\nlines.jpg"), GeoPoint(-90.0, 180.0), 360.0, None),
    Photo(Path("/photos/plain.jpg")),
]


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    """Four photos, and one that was removed between them."""
    with create(tmp_path / "city.index") as made:
        photos = [*PHOTOS[:2], Photo(Path("/photos/removed.jpg")), *PHOTOS[2:]]
        made.add(photos, descriptors(5), identities=contents("abxcd"))
        made.remove(["/photos/removed.jpg"])
        yield made


def held(index: Index) -> list[tuple[str, Photo, bytes]]:
    return [
        (content, photo, row.tobytes())
        for page in index.pages()
        for content, photo, row in zip(page.identities, page.photos, page.descriptors, strict=True)
    ]


# --- out and back ----------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_what_goes_out_comes_back(index: Index, tmp_path: Path, form: Any, dtype: Any) -> None:
    done = export(index, tmp_path / "out", form=form, dtype=dtype)
    assert (done.photos, done.damaged) == (4, [])
    rows = np.load(tmp_path / "out" / "descriptors.npy", allow_pickle=False)
    assert (rows.shape, rows.dtype) == ((4, DIM), np.dtype(dtype))
    np.testing.assert_array_equal(rows, descriptors(5)[[0, 1, 3, 4]].astype(np.float16))
    assert model_of(tmp_path / "out") == Source("fake", "print of fake", DIM)
    with create(tmp_path / "back") as back:
        assert take(back, tmp_path / "out") == 4
        assert held(back) == held(index)
        assert take(back, tmp_path / "out") == 0
        assert back.verify() == []


def test_what_other_programs_see(index: Index, tmp_path: Path) -> None:
    for form in FORMS:
        export(index, tmp_path / form, form=form)
    with (tmp_path / "csv" / "photos.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["path"] for line in lines] == [str(photo.path) for photo in PHOTOS]
    assert (lines[0]["lat"], lines[0]["lon"], lines[1]["lat"]) == ("35.681236", "139.767125", "")
    text = (tmp_path / "geojson" / "photos.geojson").read_text(encoding="utf-8")
    assert "東京駅" in text
    points = json.loads(text)
    assert points["type"] == "FeatureCollection"
    assert [point["geometry"] for point in points["features"][:2]] == [
        {"type": "Point", "coordinates": [139.767125, 35.681236]},
        None,
    ]
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    table = parquet.read_table(tmp_path / "parquet" / "photos.parquet").to_pylist()
    assert [line["heading"] for line in table] == [90.5, None, 360.0, None]


TABLES = st.lists(
    st.builds(
        Photo,
        path=st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=9)
        .filter(lambda name: name not in (".", ".."))
        .map(lambda name: Path("/photos", name)),
        where=st.none() | st.builds(GeoPoint, st.floats(-90, 90), st.floats(-180, 180)),
        heading=st.none() | st.floats(0, 360),
        time=st.none() | st.datetimes(datetime(2, 1, 1), timezones=st.none() | st.just(UTC)),
    ),
    max_size=4,
)


@settings(max_examples=30, deadline=None)
@example(photos=[Photo(Path("/photos/\r")), Photo(Path("/photos/\n\r\n"))], form="csv")
@given(photos=TABLES, form=st.sampled_from(FORMS))
def test_any_table_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, photos: list[Photo], form: str
) -> None:
    path = tmp_path_factory.mktemp("table") / f"photos.{form}"
    contents = [f"{number:032x}" for number in range(len(photos))]
    with writer(path) as put:
        put(photos[:1], contents[:1])
        put(photos[1:], contents[1:])
    assert list(read(path)) == list(zip(photos, contents, strict=True))


def test_names_that_are_not_text(tmp_path: Path) -> None:
    photo = Photo(Path(os.fsdecode(b"/photos/caf\xe9 \xff.jpg")))
    with create(tmp_path / "i") as index:
        index.add([photo], descriptors(1), identities=contents("a"))
        for form in ("csv", "geojson"):
            export(index, tmp_path / form, form=form)
            with create(tmp_path / f"back.{form}") as back:
                assert take(back, tmp_path / form) == 1
                assert list(back.photos()) == [photo]


def test_parquet_takes_no_name_that_is_not_text(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    with create(tmp_path / "i") as index:
        index.add([Photo(Path(os.fsdecode(b"/photos/caf\xe9 \xff.jpg")))], descriptors(1), identities=contents("a"))
        with pytest.raises(StoreError, match=r"is not UTF-8, and Parquet holds no other names: export as csv"):
            export(index, tmp_path / "parquet", form="parquet")
        assert not (tmp_path / "parquet").exists()


def test_an_empty_index_goes_out_and_comes_back(tmp_path: Path) -> None:
    with create(tmp_path / "i") as index:
        for form in FORMS:
            assert export(index, tmp_path / form, form=form).photos == 0
            assert take(index, tmp_path / form) == 0


def test_an_export_is_whole_or_not_there(index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(StoreError, match="already exists and is not empty"):
        export(index, tmp_path / "taken")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match="No space left on device"):
        export(index, tmp_path / "out")
    assert sorted(tmp_path.iterdir()) == before


def test_damaged_photos_are_left_out_and_named(index: Index, tmp_path: Path) -> None:
    with index._snapshot().rows.path.open("r+b") as file:
        file.write(b"\xff")
    os.truncate(index._snapshot().rows.path, 4 * DIM * 2)
    with Index.open(index.folder) as hurt, create(tmp_path / "other") as other:
        left = [PHOTOS[0].path, PHOTOS[3].path]
        done = export(hurt, tmp_path / "out")
        assert (done.photos, done.damaged) == (2, left)
        assert len(np.load(tmp_path / "out" / "descriptors.npy")) == 2
        merged = merge(other, hurt)
        assert (merged.added, merged.damaged) == (2, left)
        assert held(other) == held(hurt)


def test_parquet_needs_its_extra(index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"writing Parquet needs the 'parquet' extra"):
        export(index, tmp_path / "out", form="parquet")
    (tmp_path / "photos.parquet").touch()
    with pytest.raises(MissingExtraError, match="reading Parquet"):
        list(read(tmp_path / "photos.parquet"))


# --- from other tools ------------------------------------------------------------------------


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """What another tool might write: names of its own, float64, paths seen from the table, no contents."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    np.save(folder / "vectors.npy", descriptors(3).astype(np.float64))
    (folder / "a.jpg").write_bytes(b"a photo")
    (folder / "list.csv").write_text("Path, LAT ,lon,note\na.jpg,1,2,x\nb.jpg,,,\n/far/c.jpg,3,4,\n")
    return folder


def test_another_tools_descriptors_are_taken(tmp_path: Path, foreign: Path) -> None:
    with pytest.raises(StoreError, match=r"does not say which model .*--model"):
        model_of(foreign)
    source = model_of(foreign, name="theirs")
    assert source == model_of(foreign, name="theirs")
    assert (source.model, source.dim) == ("theirs", DIM)
    assert source.fingerprint != model_of(foreign, name="others").fingerprint
    with Index.create(tmp_path / "i", dim=DIM, fingerprint=source.fingerprint, model=source.model) as index:
        assert take(index, foreign) == 3
        assert take(index, foreign) == 0
        photos = list(index.photos())
        assert [photo.path for photo in photos] == [foreign / "a.jpg", foreign / "b.jpg", Path("/far/c.jpg")]
        assert [photo.where for photo in photos] == [GeoPoint(1, 2), None, GeoPoint(3, 4)]
        assert index.known([content_hash(foreign / "a.jpg")])  # a file that is there goes by its content
        assert [best[0].photo for best in index.search(descriptors(3), k=1)] == photos


def test_only_who_names_the_model_vouches_for_it(tmp_path: Path, foreign: Path) -> None:
    with create(tmp_path / "i", model="ours") as index:
        for model in (None, "theirs"):
            with pytest.raises(WrongModelError, match=r"made with ours .* take them into an index of their own"):
                take(index, foreign, model=model)
        assert take(index, foreign, model="ours") == 3
    wide = Index.create(tmp_path / "wide", dim=DIM + 1, fingerprint="f", model="ours")
    with wide, pytest.raises(WrongModelError):
        take(wide, foreign, model="ours")


def test_an_export_of_another_model_is_refused_whoever_vouches(index: Index, tmp_path: Path) -> None:
    export(index, tmp_path / "out")
    with create(tmp_path / "i", model="other") as other:
        for model in (None, "other"):
            with pytest.raises(WrongModelError, match=r"made with other .* holds descriptors of fake"):
                take(other, tmp_path / "out", model=model)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (np.ones((3, DIM)), r"row 0: its length is 2.82843, not 1; divide each row by its length"),
        (np.full((3, DIM), np.nan), r"row 0: its length is nan"),
        (descriptors(2), r"lists 3 photos, but .* holds 2 descriptors"),
        (np.ones(DIM), r"of shape \[8\]"),
        (np.ones((3, DIM), int), "int64"),
        (np.asfortranarray(descriptors(3)), "by columns"),
        (np.array([[{}] * DIM] * 3, dtype=object), "holds object"),
    ],
)
def test_descriptors_that_make_no_sense_add_nothing(
    tmp_path: Path, foreign: Path, rows: np.ndarray, sentence: str
) -> None:
    np.save(foreign / "vectors.npy", rows, allow_pickle=True)
    with create(tmp_path / "i", model="ours") as index:
        with pytest.raises(StoreError, match=sentence):
            take(index, foreign, model="ours")
        assert len(index) == 0


def test_a_wrong_row_is_named_by_its_number(tmp_path: Path, foreign: Path) -> None:
    rows = descriptors(3)
    rows[2] *= 2
    np.save(foreign / "vectors.npy", rows)
    with (
        create(tmp_path / "i", model="ours") as index,
        pytest.raises(StoreError, match="row 2: its length is 2"),
    ):
        take(index, foreign, model="ours")


def npy_of(kind: str, shape: str) -> bytes:
    """A `.npy` file that says this of itself and holds nothing."""
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}".encode()
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head


@pytest.mark.parametrize(
    ("raw", "sentence"),
    [
        (b"", r"is no \.npy file"),
        (b"not an array", r"is no \.npy file"),
        (b"\x93NUMPY\x03\x00", "version 3.0"),
        (b"\x93NUMPY\x01\x00\x76\x00{'descr': 'x'", r"is no \.npy file"),
        (npy_of("<f4", "3, 1048577"), "holds rows of 1,048,577 numbers"),
        (npy_of("<f4", "1" + "0" * 17 + ", 8"), r"is cut short .it should hold 1"),
        (npy_of("<f4", "True, 8"), r"is no \.npy file"),
        (npy_of("<f4", "-3, 8"), r"is no \.npy file"),
        (npy_of("<f4", "9" * 26 + ", 8"), r"is no \.npy file"),
        (npy_of("(" * 900, "3, 8"), r"is no \.npy file"),
        (npy_of("|V999999", "3, 8"), r"holds '\|V999999' of shape"),
        (npy_of("<M8[s]", "3, 8"), r"holds '<M8\[s\]' of shape"),
    ],
)
def test_what_is_no_npy_is_refused(foreign: Path, raw: bytes, sentence: str) -> None:
    (foreign / "vectors.npy").write_bytes(raw)
    with pytest.raises(StoreError, match=sentence):
        model_of(foreign, name="ours")


def test_long_headers_and_cut_files(foreign: Path, tmp_path: Path) -> None:
    with (foreign / "vectors.npy").open("wb") as file:
        np.lib.format.write_array(file, descriptors(3), version=(2, 0))
    with create(tmp_path / "i", model="ours") as index:
        assert take(index, foreign, model="ours") == 3
    os.truncate(foreign / "vectors.npy", (foreign / "vectors.npy").stat().st_size - 1)
    with pytest.raises(StoreError, match=r"is cut short .it should hold 3 rows"):
        model_of(foreign, name="ours")
    (foreign / "vectors.npy").unlink()
    (foreign / "vectors.npy").mkdir()
    with pytest.raises(StoreError, match="cannot be read"):
        model_of(foreign, name="ours")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "needs one column 'path'"),
        ("title,lat\na,1\n", "needs one column 'path', but has title, lat"),
        ("path,lat,lon\na,1,2,3\n", r"photo 1: it has more fields"),
        ("path,lat,lon\na,1,2\nb,north,3\n", r"photo 2: its lat 'north' is not a number of degrees"),
        ("path,lat,lon\na,1,\n", "its lon '' is not known, but its lat is"),
        ("path,lat,lon\na,91,0\n", "latitude 91"),
        ("path,heading\na,1e9\n", "heading '1e9' is not"),
        ("path,time\na,noon\n", r"photo 1: .*noon"),
        ("path,lat,lon\na,1_0,2\n", "lat '1_0' is not a number of degrees"),
        ("path,lat,lon\na,1,\uff11\uff12\n", "lon '\uff11\uff12' is not a number"),
        ("path,lat,lon\na,1e400,2\n", "lat '1e400' is not a number"),
        ("path,lat,lon\na," + "1" * 5000 + ",2\n", r"lat '1+'\.\.\. is not a number"),
        ("path,identity\na,\nb," + 31 * "0" + "\n", r"photo 2: its identity '0{31}' is no content hash of 32"),
        ("path,identity\na," + 32 * "G" + "\n", "photo 1: its identity"),
        ("path,identity\na," + 32 * "A" + "\n", "photo 1: its identity"),
        ("path,identity\na,../../" + 26 * "0" + "\n", "photo 1: its identity"),
        ("path\n" + "a/" * 20_000 + "\n", r"photo 1: 'a/a/.*'\.\.\. is no file's name"),
        ('path,lat\n"' + "a" * 200_000 + '",1\n', "photo 1: field larger"),
        ("path\n" + "a" * (1 << 21) + "\n", "photo 1: line 2 has over 1,048,576 letters"),
        ('path,lat\n"",1\n', "'' is no file's name"),
        ('path\n"a\n', "photo 1: "),
    ],
)
def test_tables_that_make_no_sense_are_refused(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "photos.csv").write_text(text, encoding="utf-8")
    with pytest.raises(StoreError, match=sentence) as told:
        list(read(tmp_path / "photos.csv"))
    assert len(str(told.value)) < 500


@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "[]", '{"features": [{}]}', '{"features": [{"properties": null, "geometry": null}]}'),
        *('{"features": ' + "[" * 100_000, '{"features": [7]}', '{"features": [null]}'),
        '{"features": [{"properties": {"path": 7}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "a\\u0000"}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "\\ud800"}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "a", "time": 7}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "a", "heading": {"a": 1}}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "a", "identity": 7}, "geometry": null}]}',
        '{"features": [{"properties": {"path": "a"}, "geometry": {"coordinates": [true, false]}}]}',
        '{"features": [{"properties": {"path": "a"}, "geometry": {"coordinates": [[1, 2], [3, 4]]}}]}',
        '{"features": [{"properties": {"path": "a"}, "geometry": {"coordinates": [1e400, 4]}}]}',
        '{"features": [{"properties": {"path": "a"}, "geometry": "here"}]}',
        '{"features": [{"properties": {"path": "a"}, "geometry": {"coordinates": [1]}}]}',
    ],
)
def test_geojson_that_makes_no_sense_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "photos.geojson").write_text(text)
    with pytest.raises(StoreError, match=r"photos\.geojson, photo 1: .*; correct it, or leave it out") as told:
        list(read(tmp_path / "photos.geojson"))
    assert len(str(told.value)) < 500


def test_a_table_that_is_not_there_is_a_sentence(tmp_path: Path) -> None:
    for form in FORMS:
        with pytest.raises(StoreError, match=r"cannot be read .*: check the name and permissions"):
            list(read(tmp_path / f"photos.{form}"))


def test_parquet_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    (tmp_path / "photos.parquet").write_bytes(b"PAR1 or not")
    with pytest.raises(StoreError, match="photo 1: it is no Parquet"):
        list(read(tmp_path / "photos.parquet"))


def test_a_list_may_be_written_as_any_table(tmp_path: Path) -> None:
    text = "SourceFile;Latitude;Longitude;time\na.jpg;47° 30' 0\" N;-8,25;2023:07:14 10:20:30\nb.jpg;;;\n;;;\n"
    (tmp_path / "photos.csv").write_bytes(text.encode("utf-16"))
    photos = [photo for photo, _ in read(tmp_path / "photos.csv")]
    assert photos[0] == Photo(tmp_path / "a.jpg", GeoPoint(47.5, -8.25), None, datetime(2023, 7, 14, 10, 20, 30))
    assert photos[1:] == [Photo(tmp_path / "b.jpg")]


def test_other_spellings_of_the_unknown(tmp_path: Path) -> None:
    (tmp_path / "photos.csv").write_text("path,lat,lon,heading,time\na,nan,NaN,-90,\n")
    assert list(read(tmp_path / "photos.csv")) == [(Photo(tmp_path / "a", None, 270.0, None), None)]


def test_the_folder_must_hold_one_of_each(tmp_path: Path, foreign: Path) -> None:
    with pytest.raises(StoreError, match="cannot be read"):
        model_of(tmp_path / "nothing", name="m")
    with pytest.raises(StoreError, match="no files that could be descriptors"):
        model_of(tmp_path, name="m")
    (foreign / "more.csv").touch()
    with create(tmp_path / "i", model="ours") as index:
        with pytest.raises(StoreError, match="2 files that could be a table of photos"):
            take(index, foreign, model="ours")
        (foreign / "list.csv").rename(foreign / "photos.csv")  # our own name goes before others
        assert take(index, foreign, model="ours") == 3


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"kind": "something else"}, "damaged or not of a salad export"),
        ({"dim": "8"}, "damaged or not of a salad export"),
        ({"model": None}, "damaged or not of a salad export"),
        ({"model": "\ud800"}, "damaged or not of a salad export"),
        ({"model": "m" * 5000}, "damaged or not of a salad export"),
        ({"fingerprint": "\udfff"}, "damaged or not of a salad export"),
        ({"dim": True}, "damaged or not of a salad export"),
        ({"more": "m" * 70_000}, "damaged or not of a salad export"),
        ({"dim": 9}, "says descriptors of 9 numbers, but .* holds 8"),
    ],
)
def test_a_damaged_export_is_refused(index: Index, tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    export(index, tmp_path / "out")
    told = tmp_path / "out" / "model.json"
    told.write_text(json.dumps(json.loads(told.read_text()) | change))
    with pytest.raises(StoreError, match=sentence):
        model_of(tmp_path / "out")
    for text in ("[]", "[" * 100_000, '{"a": ' * 20_000, "\0"):
        told.write_text(text)
        with pytest.raises(StoreError, match="damaged or not of a salad export"):
            model_of(tmp_path / "out")


# --- merging ---------------------------------------------------------------------------------


def test_merging_holds_each_content_once(index: Index, tmp_path: Path) -> None:
    with create(tmp_path / "other") as other:
        moved = replace(PHOTOS[3], path=Path("/elsewhere/plain.jpg"), where=GeoPoint(1, 2), heading=3.0)
        known = replace(PHOTOS[0], where=GeoPoint(5, 5))
        new, stranger = Photo(Path("/photos/new.jpg")), Photo(PHOTOS[1].path)
        other.add([moved, known, new, stranger], descriptors(4, 9), identities=contents("dans"))
        done = merge(index, other)
        assert (done.added, done.held, done.other, done.damaged) == (1, 2, [PHOTOS[1].path], [])
        learned = replace(PHOTOS[3], where=GeoPoint(1, 2), heading=3.0)
        assert list(index.photos()) == [*PHOTOS[:3], learned, new]
        assert index.search(descriptors(4, 9)[2], k=1)[0][0].photo == new
        assert index.search(descriptors(5)[4], k=1)[0][0].photo == learned  # with its first descriptor
        assert index.verify() == []
        again = merge(index, other)
        assert (again.added, again.held) == (0, 3)
    assert merge(index, index).held == 5


def test_indexes_of_two_models_are_not_merged(index: Index, tmp_path: Path) -> None:
    with (
        create(tmp_path / "other", model="other") as other,
        pytest.raises(WrongModelError, match="made with fake"),
    ):
        merge(index, other)
