"""Every layout, on a tiny set of its real shape: counts, names, positions and what is right."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets.benchmark import Benchmark
from salad.datasets.protocols import read
from salad.datasets.readers.at_names import read_side
from salad.errors import BenchmarkError
from salad.geo import GeoPoint, metres_between
from salad.images.at_names import parse_at_name

REFS = [0.0, 10.0, 24.0, 60.0, 500.0, 530.0]
ASKED = [0.0, 35.0, 300.0, 505.0]
HERE = np.array([[1.0], [2.0]])
RIGHT = [[0, 1, 2], [1, 2, 3], [], [4, 5]]


def rows(made: Benchmark) -> list[list[int]]:
    return [right.tolist() for right in made.positives]


class TestAtNames:
    @pytest.mark.parametrize("split", ["images/test", "test", "processed/test", ""])
    @pytest.mark.parametrize("zone", ["17@T", "@"])
    def test_a_street(self, tmp_path: Path, fakes: ModuleType, split: str, zone: str) -> None:
        made = read("pitts30k-test", fakes.at_names(tmp_path, REFS, ASKED, split=split, zone=zone), any_size=True)
        assert rows(made) == RIGHT
        assert made.protocol == "pitts30k-test (6 references, 4 queries)"
        assert (made.unanswerable, made.unanswerable_rule, made.counted) == (1, "miss", 4)
        assert made.groups == tuple(f"queries{row}" for row in range(4))
        where = made.references[0].where
        assert (where is None) == (zone == "@")
        assert where is None or metres_between(where, GeoPoint(40.4391, -79.9976)) < 200
        assert made.references[1].heading == 1.0
        assert made.references[0].path.is_file()

    def test_neighbours_across_a_zones_edge(self, tmp_path: Path, fakes: ModuleType) -> None:
        edge = GeoPoint(52.1, 12.0)
        fakes.at_points(tmp_path / "database", fakes.town(edge, [(0, 8.5), (0, 60), (3, -8.5)]))
        fakes.at_points(tmp_path / "queries", fakes.town(edge, [(0, -8.5)]))
        made = read("st-lucia", tmp_path)
        right = {made.references[row].path.name.rpartition("@.")[0][-1] for row in made.positives[0]}
        assert right == {"0", "2"}
        assert made.protocol == "st-lucia"

    @pytest.mark.parametrize(
        ("protocol", "sides"),
        [
            ("sfxl-v1", ("database", "queries_v1")),
            ("sfxl-v2", ("database", "queries_v2")),
            ("svox", ("gallery", "queries")),
            ("svox-night", ("gallery", "queries_night")),
            ("svox-rain", ("gallery", "queries_rain")),
            ("eynsham", ("database", "queries")),
            ("tokyo247", ("database", "queries")),
        ],
    )
    def test_each_sets_folders(self, tmp_path: Path, fakes: ModuleType, protocol: str, sides: tuple[str, str]) -> None:
        fakes.at_names(tmp_path, REFS, ASKED, sides=sides)
        made = read(protocol, tmp_path, any_size=True)
        assert rows(made) == RIGHT
        assert {photo.path.parent.name for photo in made.queries} == {sides[1]}

    def test_val_and_msls(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.at_names(tmp_path, REFS, ASKED, split="images/val")
        for protocol in ("pitts30k-val", "msls-val-11k"):
            assert rows(read(protocol, tmp_path, any_size=True)) == RIGHT
        with pytest.raises(BenchmarkError, match="looked for"):
            read("pitts30k-test", tmp_path)

    def test_folders_in_folders_and_names_without_metres(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.at_names(tmp_path, [0.0], [0.0], split="")
        fakes.touch(tmp_path / "database" / "deep" / "@er", ["@0585000.00@4477001.00@17@T@@@@.jpg"])
        assert rows(read("eynsham", tmp_path)) == [[0, 1]]
        fakes.touch(tmp_path / "database", ["@here@4477001.00@.jpg"])
        with pytest.raises(BenchmarkError, match=r"1 of 3 photos .* no easting .*@here@"):
            read("eynsham", tmp_path)

    def test_mixed_zones_without_degrees(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.at_names(tmp_path, [0.0], [0.0], split="")
        fakes.touch(tmp_path / "database", ["@0585000.00@4477001.00@@@@@.jpg"])
        with pytest.raises(BenchmarkError, match="UTM zones"):
            read("eynsham", tmp_path)

    fields = st.lists(
        st.sampled_from(
            [
                "0585000.00",
                "4477000.00",
                "17",
                "T",
                "F",
                "40.5",
                "-79.9",
                "",
                "x",
                "99",
                "i",
                "1e3",
                "-5",
                "0.0",
                "٣",
            ]
        ),
        max_size=11,
    )

    @settings(max_examples=200)
    @given(fields=fields)
    def test_as_one_name_is_read(self, tmp_path_factory: pytest.TempPathFactory, fields: list[str]) -> None:
        folder = tmp_path_factory.mktemp("n")
        name = "@" + "@".join(["0585000.00", "4477000.00", *fields]) + "@.jpg"
        (folder / name).touch()
        photos, _, _ = read_side(folder)
        told = parse_at_name(name)
        assert told is not None
        assert photos[0].heading == told.heading
        assert (photos[0].where is None) == (told.where is None)
        if told.where is not None and photos[0].where is not None:
            assert metres_between(told.where, photos[0].where) < 1e-3

    def test_other_names_are_no_at_names(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.touch(tmp_path / "queries", ["@1@2@.jpg"])
        for name in ("a.jpg", "deep/b.jpg", "deep/deeper/and/yet/deeper/@1@2@.jpg"):
            fakes.touch(tmp_path / "database", [name])
            with pytest.raises(BenchmarkError, match="looked for"):
                read("eynsham", tmp_path)

    def test_no_photo_is_looked_at(self, tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
        fakes.at_names(tmp_path, fakes.line(300, 5.0), ASKED)
        looked: list[str] = []
        plain = os.stat

        def stat(path: object, *more: object, **other: object) -> os.stat_result:
            looked.append(str(path))
            return plain(path, *more, **other)

        monkeypatch.setattr(os, "stat", stat)
        read("st-lucia", tmp_path)
        assert len(looked) < 40


class TestMsls:
    STREETS: ClassVar[dict[str, tuple[list[float], list[float]]]] = {
        "cph": (REFS, ASKED),
        "sf": ([0.0, 20.0], [10.0, 9000.0]),
    }

    def test_the_small_set_drops_what_has_no_answer(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("msls-val-740", fakes.msls(tmp_path, self.STREETS), any_size=True)
        assert rows(made) == [*RIGHT, [6, 7], []]
        assert (made.unanswerable, made.unanswerable_rule, made.counted) == (2, "drop", 4)
        assert made.protocol == "msls-val-740 (8 references, 4 queries)"
        assert made.groups == (
            "cph/drive0",
            "cph/drive0",
            "cph/drive1",
            "cph/drive1",
            "sf/drive0",
            "sf/drive0",
        )
        assert made.queries[4].path == tmp_path / "train_val/sf/query/images/sf-query-0.jpg"
        assert made.queries[4].path.is_file()
        where = made.queries[4].where
        assert where is not None
        assert metres_between(where, GeoPoint(37.77, -122.42)) < 3000

    def test_the_large_set_keeps_it_as_a_miss(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.msls(tmp_path, self.STREETS, subset=[0, 1])
        small, large = (read(f"msls-val-{size}", tmp_path, any_size=True) for size in ("740", "11k"))
        assert (len(small.queries), small.counted) == (4, 3)
        assert (len(large.queries), large.counted, large.unanswerable_rule) == (6, 6, "miss")
        assert len(small.references) == len(large.references) == 8

    def test_panoramas_are_left_out(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("msls-val-11k", fakes.msls(tmp_path, self.STREETS, panoramas=[0]), any_size=True)
        assert (len(made.references), len(made.queries)) == (6, 4)
        assert made.notes == ("4 panoramas were left out",)
        assert "cph-database-0.jpg" not in {photo.path.name for photo in made.references}
        assert rows(made)[0] == [0, 1, 2]

    def test_the_inner_folder_does_too(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.msls(tmp_path, self.STREETS)
        assert len(read("msls-val-740", tmp_path / "train_val", any_size=True).references) == 8

    def test_metres_outside_the_grid_fall_back_to_degrees(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.msls(tmp_path, {"cph": ([0.0], [0.0]), "sf": ([0.0], [0.0])})
        table = tmp_path / "train_val" / "cph" / "database" / "postprocessed.csv"
        table.write_text(table.read_text().replace("347000.0", "7000.0"))
        made = read("msls-val-11k", tmp_path, any_size=True)
        assert made.references[0].where is not None
        assert rows(made) == [[], [1]]

    def test_faults(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.msls(tmp_path, self.STREETS)
        folder = tmp_path / "train_val" / "sf" / "query"
        cases = [
            ("raw.csv", ",key,lon", ",key,lom", "lacks the column 'lon'"),
            ("raw.csv", "sf-query-1", "sf-query-7", "do not name the same photos"),
            ("raw.csv", "-122.", "west", "is no number"),
            ("raw.csv", "False\n", "maybe\n", "neither True nor False"),
            ("postprocessed.csv", ",4180000.0", ",nan", "row 1: northing 'nan' is no number"),
            ("seq_info.csv", ",drive0,0", "", "line 2: it ends before 'sequence_key'"),
            ("subtask_index.csv", "1,True,False,False,False,False,False,False\n", "", "has 1 rows"),
            ("raw.csv", ",key", '"', "cannot be read"),
        ]
        for name, old, new, says in cases:
            whole = (folder / name).read_text()
            assert old in whole
            (folder / name).write_text(whole.replace(old, new))
            with pytest.raises(BenchmarkError, match=says):
                read("msls-val-740", tmp_path, any_size=True)
            (folder / name).write_text(whole)
        (folder / "raw.csv").unlink()
        (folder / "seq_info.csv").unlink()
        with pytest.raises(BenchmarkError, match=r"sf/query lacks raw\.csv, seq_info\.csv"):
            read("msls-val-740", tmp_path, any_size=True)

    def test_no_city_of_photos(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.msls(tmp_path, {"cph": ([0.0], [0.0]), "sf": ([], [])})
        assert rows(read("msls-val-11k", tmp_path, any_size=True)) == [[0]]

    @settings(max_examples=40)
    @given(
        table=st.sampled_from(["raw.csv", "postprocessed.csv", "seq_info.csv", "subtask_index.csv"]),
        edits=st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), min_size=1, max_size=4),
    )
    def test_damage_is_a_sentence(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        fakes: ModuleType,
        table: str,
        edits: list[tuple[int, int]],
    ) -> None:
        root = fakes.msls(tmp_path_factory.mktemp("msls"), {"cph": ([0.0, 9.0], [5.0]), "sf": ([0.0], [5.0])})
        path = root / "train_val" / "cph" / "database" / table
        data = bytearray(path.read_bytes())
        for place, value in edits:
            data[place % len(data)] = value
        path.write_bytes(data)
        assert read_or_refused("msls-val-11k", root)


def read_or_refused(protocol: str, root: Path) -> bool:
    """Whether a set is read, or refused in a sentence; anything else goes through."""
    try:
        return len(read(protocol, root, any_size=True).references) > 0
    except BenchmarkError as error:
        return bool(str(error))


class TestDbStruct:
    @pytest.mark.parametrize("order", ["<", ">"])
    def test_a_street(self, tmp_path: Path, fakes: ModuleType, order: str) -> None:
        made = read(
            "pitts30k-test",
            fakes.dbstruct(tmp_path, "pitts30k_test", REFS, ASKED, order=order),
            layout="dbStruct",
            any_size=True,
        )
        assert rows(made) == RIGHT
        assert made.queries[0].path == tmp_path / "queries_real/000/000000_pitch1_yaw1.jpg"
        assert made.groups == ("000/000000", "000/000000", "000/000001", "000/000001")
        where = made.references[0].where
        assert where is not None
        assert metres_between(where, GeoPoint(40.4391, -79.9976)) < 200

    def test_tokyos_png(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.dbstruct(tmp_path / "tokyo247", "tokyo247", REFS, ASKED, photos=".png")
        made = read("tokyo247", tmp_path, any_size=True)
        assert made.references[0].path.suffix == ".png"
        assert all(photo.path.is_file() for photo in made.references)

    def test_a_file_of_another_distance(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.dbstruct(tmp_path, "pitts30k_test", REFS, ASKED, metres=10.0)
        with pytest.raises(BenchmarkError, match="calls 10 m right, but pitts30k-test means 25 m"):
            read("pitts30k-test", tmp_path, any_size=True)

    def test_fields_by_their_order(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.dbstruct(tmp_path, "pitts30k_test", REFS, ASKED)
        whole = fakes.dbstruct(tmp_path, "pitts30k_test", REFS, ASKED, packed=False) / "pitts30k_test.mat"
        whole.write_bytes(whole.read_bytes().replace(b"utmDb", b"dbUtm"))
        assert rows(read("pitts30k-test", tmp_path, any_size=True)) == RIGHT

    def test_parts_that_do_not_fit(self, tmp_path: Path, fakes: ModuleType) -> None:
        path = tmp_path / "pitts30k_test.mat"
        good = {
            "dbImageFns": ["a.jpg"],
            "utmDb": HERE,
            "qImageFns": ["b.jpg"],
            "utmQ": HERE,
        }
        fakes.touch(tmp_path, ["a.jpg"])
        for change, says in (
            ({"utmQ": HERE.T}, "2 x 1 metres"),
            ({"qImageFns": "b"}, "lacks a list of photos"),
            ({"qImageFns": []}, "2 x 0 metres"),
            ({}, r"names 'b.jpg' first, which was looked for in .*queries_real"),
        ):
            path.write_bytes(fakes.mat_file(good | change))
            with pytest.raises(BenchmarkError, match=says):
                read("pitts30k-test", tmp_path, any_size=True)
        fakes.touch(tmp_path, ["b.jpg"])
        assert rows(read("pitts30k-test", tmp_path, any_size=True)) == [[0]]
        path.write_bytes(
            fakes.mat_file(
                good | {"qImageFns": [], "utmQ": np.zeros((2, 0)), "dbImageFns": [], "utmDb": np.zeros((2, 0))}
            )
        )
        with pytest.raises(BenchmarkError, match="names no photos"):
            read("pitts30k-test", tmp_path, any_size=True)


class TestNpy:
    def test_three_arrays(self, tmp_path: Path, fakes: ModuleType) -> None:
        theirs, ours = [f"ref/{row}.jpg" for row in range(6)], [f"query/{row}.jpg" for row in range(4)]
        fakes.npy_triple(tmp_path, "SPED", theirs, ours, RIGHT)
        made = read("sped", tmp_path, layout="npy triple", any_size=True)
        assert rows(made) == RIGHT
        assert [photo.path for photo in made.queries] == [tmp_path / name for name in ours]
        assert made.notes == ("what is right is as SPED_gt.npy says",)
        assert made.groups is None

    def test_msls_keeps_those_that_do_not_count(self, tmp_path: Path, fakes: ModuleType) -> None:
        inner = tmp_path / "msls_val"
        names = (
            [f"train_val/sf/{side}/images/{row}.jpg" for row in range(n)] for side, n in (("database", 5), ("query", 4))
        )
        fakes.npy_triple(inner, "msls_val", *names, [[3, 1], [0], [4]], counted=[2, 0, 3])
        made = read("msls-val-740", tmp_path, any_size=True)
        assert rows(made) == [[0], [], [1, 3], [4]]
        assert (len(made.queries), made.counted, made.unanswerable) == (4, 3, 1)

    def test_faults(self, tmp_path: Path, fakes: ModuleType) -> None:
        def write(right: list[list[int]], **more: object) -> None:
            fakes.npy_triple(tmp_path, "sped", ["a.jpg", "b.jpg"], ["c.jpg"], right, **more)

        def write_gt(right: list[list[int]]) -> None:
            np.save(tmp_path / "sped_gt.npy", fakes.ragged(right), allow_pickle=True)

        for odd in ("", "c\0.jpg"):
            write([[0]])
            held = np.empty(2, dtype=object)
            held[:] = ["c.jpg", odd]
            np.save(tmp_path / "sped_qImages.npy", held, allow_pickle=True)
            write_gt([[0], [0]])
            with pytest.raises(BenchmarkError, match="is no file's name"):
                read("sped", tmp_path, any_size=True)
        write([[2]])
        with pytest.raises(BenchmarkError, match="right for query 0 that is not among 2"):
            read("sped", tmp_path, any_size=True)
        write([[0], [1]])
        with pytest.raises(BenchmarkError, match="for 2 queries, but there are 1"):
            read("sped", tmp_path, any_size=True)
        for counted in ([1], [0, 0]):
            write([[0]] * len(counted), counted=counted)
            (tmp_path / "sped_gt.npy").unlink(missing_ok=True)
            with pytest.raises(BenchmarkError, match=r"sped_qIdx\.npy should name"):
                read("sped", tmp_path, any_size=True)
        (tmp_path / "sped_pIdx.npy").unlink()
        with pytest.raises(BenchmarkError, match=r"no sped_gt\.npy or sped_pIdx\.npy"):
            read("sped", tmp_path, any_size=True)
        fakes.malicious_npy(tmp_path / "sped_gt.npy", tmp_path / "ran")
        with pytest.raises(BenchmarkError, match="nothing of it was run"):
            read("sped", tmp_path, any_size=True)
        assert not (tmp_path / "ran").exists()


class TestNpz:
    def test_two_lists(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("pitts30k-test", fakes.npz(tmp_path, "pitts30k_test", REFS, ASKED), any_size=True)
        assert rows(made) == RIGHT
        assert made.groups is not None
        assert made.references[0].where is not None
        assert all(photo.path.is_file() for photo in (*made.references, *made.queries))

    def test_names_inside_and_metres_turned(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.touch(tmp_path, ["a.jpg", "b.jpg", "c.jpg", "q.jpg"])
        metres = np.array([[0.0, 20.0, 30.0], [0.0, 0.0, 0.0]])
        np.savez(
            tmp_path / "tokyo247.npz",
            utmQ=np.zeros((1, 2)),
            utmDb=metres,
            posDistThr=25,
            dbImages=np.array(["a.jpg", "b.jpg", "c.jpg"]),
            qImages=np.array(["q.jpg"]),
        )
        assert rows(read("tokyo247", tmp_path, any_size=True)) == [[0, 1]]

    def test_faults(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.npz(tmp_path, "pitts30k_test", REFS, ASKED, metres=10.0)
        with pytest.raises(BenchmarkError, match=r"calls \[10\.0\] m right"):
            read("pitts30k-test", tmp_path, any_size=True)
        fakes.npz(tmp_path, "pitts30k_test", REFS, ASKED)
        names = tmp_path / "pitts30k_test_imageNames_query.txt"
        names.write_text("only.jpg\n")
        with pytest.raises(BenchmarkError, match="metres for 1 photos"):
            read("pitts30k-test", tmp_path, any_size=True)
        names.write_bytes(b"\xff\xfe\xfa")
        with pytest.raises(BenchmarkError, match=r"the list .* cannot be read"):
            read("pitts30k-test", tmp_path, any_size=True)
        names.unlink()
        with pytest.raises(BenchmarkError, match="two lists of names"):
            read("pitts30k-test", tmp_path, any_size=True)
        np.savez(tmp_path / "pitts30k_test.npz", utmQ=np.zeros((1, 2)))
        with pytest.raises(BenchmarkError, match="holds no utmDb"):
            read("pitts30k-test", tmp_path, any_size=True)


class TestDrives:
    def test_nordland_one_frame(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("nordland-1f", fakes.numbered(tmp_path, range(31), range(4)), any_size=True)
        assert rows(made) == [[0, 1], [9, 10, 11], [19, 20, 21], [29, 30]]

    def test_nordland_two_frames_by_the_numbers(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("nordland-2f", fakes.numbered(tmp_path, range(20), [0, 8, 16]), any_size=True)
        assert rows(made) == [[0, 1, 2], [6, 7, 8, 9, 10], [14, 15, 16, 17, 18]]

    def test_numbers_that_tell_no_frame(self, tmp_path: Path, fakes: ModuleType) -> None:
        with pytest.raises(BenchmarkError, match="numbered 0 to 4 without a gap"):
            read("nordland-2f", fakes.numbered(tmp_path, range(40), range(5)), any_size=True)
        fakes.numbered(tmp_path / "b", range(3), [10**19])
        with pytest.raises(BenchmarkError, match="no frame's number"):
            read("nordland-2f", tmp_path / "b", any_size=True)

    def test_nordland_ten_frames(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("nordland-10f", fakes.numbered(tmp_path, range(25), range(25)), any_size=True)
        assert rows(made)[0] == list(range(11))
        assert rows(made)[12] == list(range(2, 23))
        mocked = read("nordland-10f", fakes.mock_names(tmp_path / "m", range(25), step=2.4), any_size=True)
        assert [len(right) for right in mocked.positives] == [len(right) for right in made.positives]

    def test_sped(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("sped", fakes.numbered(tmp_path, range(1, 8), range(1, 8)), any_size=True)
        assert rows(made) == [[row] for row in range(7)]
        mocked = read("sped", fakes.mock_names(tmp_path / "m", range(1, 8)), any_size=True)
        assert rows(mocked) == rows(made)


class TestPairsAndPlaces:
    def test_amstertime(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("amstertime", fakes.pairs(tmp_path, [1, 2, 11], only_new=[7]))
        pairs = [
            (photo.path.stem, [made.references[row].path.stem for row in right])
            for photo, right in zip(made.queries, made.positives, strict=True)
        ]
        assert pairs == [("1", ["1"]), ("11", ["11"]), ("2", ["2"])]
        assert made.references[0].path.suffix == ".png"
        mocked = read("amstertime", fakes.mock_names(tmp_path / "m", [1, 2, 11]))
        assert rows(mocked) == [[0], [1], [2]]

    def test_gsv_cities(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("gsv-cities", fakes.gsv_cities(tmp_path, {"Rome": [4, 3, 5], "Bath": [4]}))
        assert rows(made) == [[0, 1, 2], [3, 4, 5], [6, 7, 8, 9]]
        assert [photo.path.name.split("_")[3] for photo in made.queries] == ["04", "04", "05"]
        assert made.groups is not None
        assert made.groups[0].endswith("/Bath/0")
        assert made.queries[0].path.is_file()
        assert made.queries[0].where is not None
        with pytest.raises(BenchmarkError, match="no place of four photos"):
            read("gsv-cities", fakes.gsv_cities(tmp_path / "few", {"Rome": [3]}))
