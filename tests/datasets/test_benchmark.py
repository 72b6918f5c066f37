"""Benchmarks from two folders: what is right, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from salad.datasets import benchmark as benchmarks
from salad.datasets.benchmark import Benchmark, from_frames, from_radius, from_truth
from salad.datasets.protocols import read
from salad.errors import BenchmarkError, PhotoError
from salad.geo import GeoPoint, metres_between, shifted
from salad.images.at_names import at_name
from salad.images.photo import Photo

HERE = GeoPoint(41.65, -0.88)


def touch(folder: Path, *names: str) -> Path:
    """Photos that nobody decodes: names are all these builders look at."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


@pytest.fixture
def refs(tmp_path: Path) -> Path:
    return touch(tmp_path / "set" / "refs", "a.jpg", "b.jpg", "sub/c.jpg", "sub/d.jpg", "other/d.jpg")


@pytest.fixture
def asked(tmp_path: Path) -> Path:
    return touch(tmp_path / "set" / "asked", "x.jpg", "y.jpg", "z.jpg")


def truth(tmp_path: Path, text: str, encoding: str = "utf-8") -> Path:
    path = tmp_path / "gt.csv"
    path.write_text(text, encoding=encoding)
    return path


def named(benchmark: Benchmark) -> dict[str, set[str]]:
    """What is right, by file names."""
    return {
        photo.path.name: {benchmark.references[row].path.name for row in rows}
        for photo, rows in zip(benchmark.queries, benchmark.positives, strict=True)
    }


class TestTruth:
    def test_names_paths_and_unanswerable(self, tmp_path: Path, refs: Path, asked: Path) -> None:
        csv = truth(tmp_path, "note,query,positives\nfine,z.jpg, b.jpg ; c.jpg;\n,x.jpg,\n,./y.jpg,a.jpg;a.jpg\n")
        made = from_truth(refs, asked, csv)
        assert named(made) == {"z.jpg": {"b.jpg", "c.jpg"}, "x.jpg": set(), "y.jpg": {"a.jpg"}}
        assert [photo.path.name for photo in made.queries] == ["z.jpg", "x.jpg", "y.jpg"]
        assert (made.name, made.protocol, made.unanswerable, made.notes) == ("set", "truth gt.csv", 1, ())
        assert all(rows.dtype == np.int64 for rows in made.positives)

    def test_photos_left_out_are_told(self, tmp_path: Path, refs: Path, asked: Path) -> None:
        made = from_truth(refs, asked, truth(tmp_path, "query,positives\nx.jpg,a.jpg\n"), name="mine")
        assert len(made.queries) == 1
        assert made.name == "mine"
        assert made.notes[0].startswith("2 photos of ")

    def test_path_tells_same_names_apart(self, tmp_path: Path, refs: Path, asked: Path) -> None:
        made = from_truth(refs, asked, truth(tmp_path, "query,positives\nx.jpg,sub/d.jpg;other\\d.jpg\n"))
        parents = {made.references[row].path.parent.name for row in made.positives[0]}
        assert parents == {"sub", "other"}

    def test_byte_order_mark_and_quotes(self, tmp_path: Path, refs: Path, asked: Path) -> None:
        csv = truth(tmp_path, 'query,positives\r\n"x.jpg","a.jpg;b.jpg"\r\n', encoding="utf-8-sig")
        assert named(from_truth(refs, asked, csv)) == {"x.jpg": {"a.jpg", "b.jpg"}}

    @pytest.mark.parametrize(
        ("text", "says"),
        [
            ("query,right\nx.jpg,a.jpg\n", "line 1 .* lacks the column 'positives'"),
            ("", "lacks the column 'query'"),
            ("query,positives\nx.jpg,a.jpg\nnone.jpg,a.jpg\n", "line 3 .* 'none.jpg', which is not a photo"),
            ("query,positives\nx.jpg,a.jpg;none.jpg\n", "line 2 .* 'none.jpg', which is not a photo"),
            ("query,positives\nx.jpg,d.jpg\n", "'d.jpg', which 2 photos .* write the path"),
            ("query,positives\nx.jpg,a.jpg\n./x.jpg,b.jpg\n", "line 3 .* a second time"),
            ("query,positives\nx.jpg\n", "line 2 .* lacks a query or its positives"),
            ("query,positives\n ,a.jpg\n", "line 2 .* lacks a query or its positives"),
            ("query,positives\n", "0 queries"),
            ('query,positives\n"x.jpg,a.jpg\n', "cannot be read"),
        ],
    )
    def test_bad_tables(self, tmp_path: Path, refs: Path, asked: Path, text: str, says: str) -> None:
        with pytest.raises(BenchmarkError, match=says):
            from_truth(refs, asked, truth(tmp_path, text))

    def test_unreadable_tables(self, tmp_path: Path, refs: Path, asked: Path) -> None:
        with pytest.raises(BenchmarkError, match=r"none\.csv cannot be read"):
            from_truth(refs, asked, tmp_path / "none.csv")
        with pytest.raises(BenchmarkError, match="UTF-8"):
            from_truth(refs, asked, truth(tmp_path, "query,positives\n\u00e9.jpg,\n", encoding="latin-1"))

    def test_real_tables(self, shared: Path) -> None:
        root = shared / "data" / "eval"
        counts = {}
        for name in ("essex", "corridor", "toy"):
            made = from_truth(root / name / "database", root / name / "queries", root / name / "gt.csv")
            counts[made.name] = (len(made.queries), len(made.references), made.unanswerable)
        assert counts == {"essex": (210, 210, 0), "corridor": (111, 111, 0), "toy": (5, 17, 0)}


class TestFrames:
    @settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=40)
    @given(
        ours=st.lists(st.integers(0, 40), min_size=1, unique=True),
        theirs=st.lists(st.integers(0, 40), min_size=1, unique=True),
        tolerance=st.integers(0, 5),
    )
    def test_against_the_definition(
        self, tmp_path_factory: pytest.TempPathFactory, ours: list[int], theirs: list[int], tolerance: int
    ) -> None:
        root = tmp_path_factory.mktemp("drive")
        refs = touch(root / "r", *(f"cam2_{frame}.png" for frame in ours))
        asked = touch(root / "q", *(f"2024-x{frame:05d}end.png" for frame in theirs))
        made = from_frames(refs, asked, tolerance)
        frames = [int(photo.path.stem.removeprefix("cam2_")) for photo in made.references]
        for photo, rows in zip(made.queries, made.positives, strict=True):
            frame = int(photo.path.stem[6:11])
            right = [row for row, other in enumerate(frames) if abs(other - frame) <= tolerance]
            assert rows.tolist() == right
        assert made.protocol == f"frames ±{tolerance}"

    def test_numbers_longer_than_an_int64(self, tmp_path: Path) -> None:
        stamp = 10**30
        refs = touch(tmp_path / "r", f"{stamp}.jpg", f"{stamp + 2}.jpg")
        made = from_frames(refs, touch(tmp_path / "q", f"{stamp + 3}.jpg"), 1)
        assert named(made) == {f"{stamp + 3}.jpg": {f"{stamp + 2}.jpg"}}

    def test_refusals(self, tmp_path: Path) -> None:
        asked = touch(tmp_path / "q", "1.jpg")
        with pytest.raises(BenchmarkError, match=r"plain\.jpg has no number"):
            from_frames(touch(tmp_path / "r", "plain.jpg"), asked, 1)
        with pytest.raises(BenchmarkError, match="are both frame 7"):
            from_frames(touch(tmp_path / "s", "a7.jpg", "b007.jpg"), asked, 1)
        with pytest.raises(BenchmarkError, match="-1 frames"):
            from_frames(touch(tmp_path / "t", "1.jpg"), asked, -1)

    def test_gardens_point(self, shared: Path) -> None:
        root = shared / "data" / "eval" / "gardens-point"
        made = from_frames(root / "day_left", root / "day_right", 2)
        assert [len(rows) for rows in made.positives] == [3, 4, *[5] * 196, 4, 3]


def at_photos(folder: Path, points: list[GeoPoint]) -> Path:
    return touch(folder, *(at_name(point, note=str(number)) for number, point in enumerate(points)))


class TestRadius:
    @settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=40)
    @given(
        spots=st.lists(st.tuples(st.integers(-60, 60), st.integers(-60, 60)), min_size=2, max_size=12),
        base=st.sampled_from([HERE, GeoPoint(-16.9, 179.9999), GeoPoint(69.65, 18.0), GeoPoint(0.0, 6.0)]),
        radius=st.floats(0.5, 90),
    )
    def test_against_the_definition(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        spots: list[tuple[int, int]],
        base: GeoPoint,
        radius: float,
    ) -> None:
        points = [shifted(base, north, east) for north, east in spots]
        root = tmp_path_factory.mktemp("town")
        refs, asked = at_photos(root / "r", points[1::2]), at_photos(root / "q", points[::2])
        made = from_radius(refs, asked, radius)
        for photo, rows in zip(made.queries, made.positives, strict=True):
            assert photo.where is not None
            away = [metres_between(photo.where, other.where) for other in made.references if other.where]
            sure = {row for row, distance in enumerate(away) if distance < radius - 1e-6}
            maybe = {row for row, distance in enumerate(away) if distance < radius + 1e-6}
            assert sure <= set(rows.tolist()) <= maybe
            assert rows.tolist() == sorted(rows.tolist())

    def test_a_big_radius_reaches_over_the_pole(self, tmp_path: Path) -> None:
        refs, asked = at_photos(tmp_path / "r", [GeoPoint(83.5, 170)]), at_photos(tmp_path / "q", [HERE])
        assert from_radius(refs, asked, 2.1e7).unanswerable == 0
        assert from_radius(refs, asked, 25).unanswerable == 1

    def test_refusals(self, tmp_path: Path) -> None:
        placed, nowhere = at_photos(tmp_path / "r", [HERE]), tmp_path / "n"
        nowhere.mkdir()
        Image.new("RGB", (8, 8)).save(nowhere / "lost.jpg")
        with pytest.raises(BenchmarkError, match=r"1 of 1 query photos have no position, the first .*lost\.jpg"):
            from_radius(placed, nowhere, 25)
        with pytest.raises(BenchmarkError, match="1 of 1 reference photos have no position"):
            from_radius(nowhere, placed, 25)
        for radius in (0, -1, float("nan"), float("inf")):
            with pytest.raises(BenchmarkError, match="radius"):
                from_radius(placed, placed, radius)

    @pytest.mark.parametrize("zone", ["", "@@@@@p1@@270@@@@", "@32@"])
    def test_names_without_zone_or_letter_are_judged_on_the_map(self, tmp_path: Path, zone: str) -> None:
        for side, off in (("r", 0.0), ("q", 3.0)):
            touch(tmp_path / side, *(f"@{478000 + 20 * n + off:.2f}@{5262000 + off:.2f}{zone}@.jpg" for n in range(5)))
        made = from_radius(tmp_path / "r", tmp_path / "q", 20.0)
        assert made.protocol == "radius 20 m (UTM)"
        assert "without a UTM zone" in made.notes[0]
        assert [rows.tolist() for rows in made.positives] == [[0, 1], [1, 2], [2, 3], [3, 4], [4]]
        if "270" in zone:
            alike = from_radius(tmp_path / "r", tmp_path / "q", 20.0, heading=10)
            assert [rows.tolist() for rows in alike.positives] == [rows.tolist() for rows in made.positives]

    @pytest.mark.parametrize(
        ("reference", "query", "says"),
        [
            (
                "@478000.00@5262000.00@32@T@.jpg",
                "@478001.00@5262000.00@.jpg",
                r"@\.jpg \(its name gives metres, but no",
            ),
            (
                "@478000.00@5262000.00@32@@.jpg",
                "@478001.00@5262000.00@33@@.jpg",
                r"@\.jpg \(its name gives metres, but no",
            ),
            (
                "@8.700000@47.500001@.jpg",
                "@8.7012@47.5@.jpg",
                "where metres east and north belong, .* these are degrees",
            ),
        ],
    )
    def test_what_cannot_be_compared_on_one_map_is_said(
        self, tmp_path: Path, reference: str, query: str, says: str
    ) -> None:
        with pytest.raises(BenchmarkError, match=says):
            from_radius(touch(tmp_path / "r", reference), touch(tmp_path / "q", query), 25)

    @pytest.mark.parametrize(
        "kind",
        [
            "full",
            "comma",
            "exponent",
            "hemisphere_S",
            "zone_and_letter_together",
            "utm_no_zone",
            "utm_no_zone_tail",
            "pseudo",
        ],
    )
    def test_sets_of_people(self, cases: Path, kind: str) -> None:
        folder = cases / "12-own-at-names" / kind / "images/test"
        made = from_radius(folder / "database", folder / "queries", 25)
        near = {query.path.name: len(rows) for query, rows in zip(made.queries, made.positives, strict=True)}
        assert len(near) == 6
        assert set(near.values()) == {1}

    def test_degrees_in_place_of_metres(self, cases: Path) -> None:
        folder = cases / "12-own-at-names/lonlat"
        inside = folder / "images/test"
        for judge in (
            lambda: from_radius(inside / "database", inside / "queries", 25),
            lambda: read("st-lucia", folder, any_size=True),
        ):
            with pytest.raises(BenchmarkError, match=r"say 8\.7.* and 47\.5 where metres east and north belong"):
                judge()

    def test_protocol_and_positions(self, tmp_path: Path) -> None:
        refs, asked = at_photos(tmp_path / "r", [HERE]), at_photos(tmp_path / "q", [shifted(HERE, 3, 4)])
        made = from_radius(refs, asked, 25.0)
        assert made.protocol == "radius 25 m"
        assert made.references[0].where is not None
        assert named(made) == {made.queries[0].path.name: {made.references[0].path.name}}

    def test_sfxl(self, shared: Path) -> None:
        root = shared / "data" / "eval" / "sfxl-30" / "images" / "test"
        made = from_radius(root / "database", root / "queries", 25)
        assert (len(made.queries), made.unanswerable) == (60, 0)


def test_a_photo_on_both_sides_is_refused(refs: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="share no photo"):
        from_frames(refs, refs / "sub", 1)
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "1.jpg").symlink_to(refs / "a.jpg")
    with pytest.raises(BenchmarkError, match=r"1 photos are references and queries at once.*a\.jpg"):
        from_frames(refs, linked, 1)


def test_a_missing_folder_is_named(refs: Path, tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="absent"):
        from_frames(refs, tmp_path / "absent", 1)


def test_a_set_on_two_drives_is_named_after_its_references(monkeypatch: pytest.MonkeyPatch, refs: Path) -> None:
    def apart(_: object) -> str:
        raise ValueError("paths on different drives")

    monkeypatch.setattr(benchmarks.os.path, "commonpath", apart)
    assert benchmarks._common_name(refs, refs) == "refs"


class TestParts:
    photos = (Photo(Path("a.jpg")), Photo(Path("b.jpg")))

    def test_empty_sides(self) -> None:
        with pytest.raises(BenchmarkError, match="0 references"):
            Benchmark("x", "p", (), self.photos, (np.array([0]), np.array([0])))

    def test_counts(self) -> None:
        with pytest.raises(BenchmarkError, match="2 queries but positives for 1"):
            Benchmark("x", "p", self.photos, self.photos, (np.array([0]),))

    @pytest.mark.parametrize("row", [-1, 2])
    def test_rows(self, row: int) -> None:
        with pytest.raises(BenchmarkError, match=r"b\.jpg is not among the 2 references"):
            Benchmark("x", "p", self.photos, self.photos, (np.array([0]), np.array([row])))
