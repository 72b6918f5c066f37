"""The table of protocols against its specification; a folder that is another set is refused with what differs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from salad.datasets import protocols
from salad.datasets.benchmark import from_radius
from salad.datasets.compact_lists import PhotoList, Ragged
from salad.datasets.protocols import LAYOUTS, PROTOCOLS, read
from salad.datasets.readers.base import EveryNth, Frames, OwnTable, Protocol, Radius, SameName, Sides, right_by
from salad.errors import BenchmarkError, PhotoError
from salad.geo import GeoPoint
from salad.images.photo_table import PhotoTable


def specified(shared: Path) -> dict[str, tuple[int | None, int | None]]:
    """Names and counts by the specification's table; a round or an open number is None."""
    text = (shared / "spec" / "datasets.md").read_text()
    table = text[text.index("## Protocols") : text.index("## Layouts")]
    found: dict[str, tuple[int | None, int | None]] = {}
    counts: list[int | None] = [None]
    for line in table.splitlines():
        names, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        if "`" not in names:
            continue
        sides = [
            [int(n.replace(",", "")) if "million" not in cell else None for n in re.findall(r"\d[\d,]*", cell)]
            for cell in cells[:2]
        ]
        references, queries = (
            side or (counts if "same" in cell else [None]) for side, cell in zip(sides, cells, strict=False)
        )
        counts = references
        for place, name in enumerate(re.findall(r"`([^`]+)`", names)):
            found[name] = references[min(place, len(references) - 1)], queries[min(place, len(queries) - 1)]
    return found


def test_every_row_of_the_specification(shared: Path) -> None:
    rows = specified(shared)
    assert len(rows) == 18
    for name, (references, queries) in rows.items():
        matching = [
            p for p in PROTOCOLS.values() if p.name == name or (name.endswith("*") and p.name.startswith(name[:-1]))
        ]
        assert matching, name
        for protocol in matching:
            assert references is None or protocol.references == references, name
            assert protocol.queries == queries, name


def test_every_entry_is_whole() -> None:
    for name, protocol in PROTOCOLS.items():
        assert protocol.name == name
        assert set(protocol.layouts) <= set(LAYOUTS)
        assert protocol.get
        assert protocol.licence
        assert (protocol.unanswerable == "drop") == (protocol.yours or name == "msls-val-740")
    assert set(LAYOUTS) == {layout for protocol in PROTOCOLS.values() for layout in protocol.layouts}


class TestCounts:
    def test_the_published_counts_pass(self, tmp_path: Path, fakes: ModuleType) -> None:
        made = read("sped", fakes.numbered(tmp_path, range(607), range(607)))
        assert (made.protocol, made.name, made.notes) == ("sped", tmp_path.name, ())
        assert [rows.tolist() for rows in made.positives] == [[row] for row in range(607)]

    def test_others_are_refused_with_what_differs(self, tmp_path: Path, fakes: ModuleType) -> None:
        fakes.numbered(tmp_path, range(606), range(605))
        with pytest.raises(
            BenchmarkError,
            match=r"read as drives, is not sped: expected 607 references, found 606; expected 607 queries, found 605",
        ):
            read("sped", tmp_path)
        assert read("sped", tmp_path, any_size=True).protocol == "sped (606 references, 605 queries)"

    def test_of_dropped_queries_only_the_answerable_count(
        self, tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        fakes.msls(tmp_path, {"cph": ([0.0], [5.0, 900.0]), "sf": ([0.0], [5.0])})
        for counts, right in (((2, 2), True), ((2, 3), False)):
            small = replace(PROTOCOLS["msls-val-740"], references=counts[0], queries=counts[1])
            monkeypatch.setitem(PROTOCOLS, "msls-val-740", small)
            if right:
                assert len(read("msls-val-740", tmp_path).queries) == 3
            else:
                with pytest.raises(BenchmarkError, match="expected 3 queries with an answer, found 2"):
                    read("msls-val-740", tmp_path)

    def test_a_round_number_is_taken_as_one(
        self, tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        fakes.at_names(tmp_path, fakes.line(28, 9.0), fakes.line(3, 9.0), sides=("database", "queries_v1"))
        for about, fits in ((2, True), (1, False)):
            monkeypatch.setitem(
                PROTOCOLS, "sfxl-v1", replace(PROTOCOLS["sfxl-v1"], references=30, queries=3, about=about)
            )
            if fits:
                assert len(read("sfxl-v1", tmp_path).references) == 28
            else:
                with pytest.raises(BenchmarkError, match="expected about 30 references, found 28"):
                    read("sfxl-v1", tmp_path)


class TestAbsent:
    @pytest.mark.parametrize("name", [name for name, protocol in PROTOCOLS.items() if protocol.get])
    def test_what_was_looked_for_and_where_to_get_it(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(BenchmarkError) as told:
            read(name, tmp_path, **({"tolerance": 1} if name == "frames" else {}))
        assert "looked for" in str(told.value)
        assert PROTOCOLS[name].get in str(told.value)
        assert PROTOCOLS[name].licence in str(told.value)

    def test_no_folder_no_protocol_no_layout(self, tmp_path: Path, fakes: ModuleType) -> None:
        with pytest.raises(BenchmarkError, match="which is no folder"):
            read("sped", tmp_path / "absent")
        with pytest.raises(BenchmarkError, match="no protocol 'msls': give one of msls-val-740"):
            read("msls", tmp_path)
        fakes.numbered(tmp_path, range(3), range(3))
        with pytest.raises(BenchmarkError, match="is not read from the layout 'MSLS tables'"):
            read("sped", tmp_path, layout="MSLS tables")
        with pytest.raises(BenchmarkError, match="looked for"):
            read("sped", tmp_path, layout="npy triple")

    def test_a_published_protocol_takes_no_rule_of_yours(self, tmp_path: Path) -> None:
        with pytest.raises(BenchmarkError, match="takes no metres"):
            read("sped", tmp_path, metres=50)
        with pytest.raises(BenchmarkError, match="takes no tolerance"):
            read("folder", tmp_path, tolerance=1)


class TestOwn:
    def test_frames(self, shared: Path, tmp_path: Path, fakes: ModuleType) -> None:
        root = shared / "data" / "eval" / "gardens-point"
        made = read("frames", root / "day_left", queries=root / "day_right", tolerance=2)
        assert (made.protocol, len(made.queries), made.unanswerable_rule) == ("frames ±2", 200, "drop")
        fakes.numbered(tmp_path, range(5), range(5))
        assert len(read("frames", tmp_path, tolerance=0).queries) == 5
        with pytest.raises(BenchmarkError, match="needs a tolerance"):
            read("frames", tmp_path)

    def test_truth(self, shared: Path, tmp_path: Path) -> None:
        made = read("truth", shared / "data" / "eval" / "toy")
        assert (made.protocol, len(made.references), len(made.queries)) == ("truth gt.csv", 17, 5)

    def test_folder(self, shared: Path) -> None:
        made = read("folder", shared / "data" / "eval" / "sfxl-30" / "images" / "test")
        assert (made.protocol, len(made.queries), made.unanswerable) == ("radius 25 m", 60, 0)

    def test_the_same_set_by_names_alone(self, shared: Path) -> None:
        """On the map and along the earth a radius is the same to a few centimetres."""
        root = shared / "data" / "eval" / "sfxl-30"
        ours = read("st-lucia", root)
        theirs = read("folder", root / "images" / "test")
        named = [{made.references[row].path.name for row in rows} for made in (ours, theirs) for rows in made.positives]
        pairs = list(zip(named[:60], named[60:], strict=True))
        assert sum(len(a ^ b) for a, b in pairs) <= 0.01 * sum(len(a) for a, _ in pairs)

    def test_headings(self, tmp_path: Path, fakes: ModuleType) -> None:
        here = GeoPoint(41.65, -0.88)
        refs = fakes.at_points(tmp_path / "r", [here] * 3, [355.0, 40.0, 180.0])
        asked = fakes.at_points(tmp_path / "q", [here], [10.0])
        turned = {
            made.protocol: made for made in (read("folder", refs, queries=asked, heading=h) for h in (15, 30, 180))
        }
        looks = {
            protocol: {made.references[row].heading for row in made.positives[0]} for protocol, made in turned.items()
        }
        assert looks == {
            "radius 25 m, heading ±15°": {355.0},
            "radius 25 m, heading ±30°": {355.0, 40.0},
            "radius 25 m, heading ±180°": {355.0, 40.0, 180.0},
        }
        blind = fakes.at_points(tmp_path / "b", [here])
        Image.new("RGB", (8, 8)).save(next(blind.iterdir()))
        with pytest.raises(BenchmarkError, match="1 of 1 photos have no heading"):
            read("folder", refs, queries=blind, heading=15)
        with pytest.raises(BenchmarkError, match="within 181 degrees"):
            read("folder", refs, queries=asked, heading=181)

    def test_nothing_is_opened_where_names_or_a_table_say_enough(
        self, tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        here = GeoPoint(41.65, -0.88)
        refs, plain = fakes.at_points(tmp_path / "r", [here]), fakes.touch(tmp_path / "q", ["a.jpg"])
        (tmp_path / "t.csv").write_text("path,lat,lon\nq/a.jpg,41.65,-0.88\n")

        def opened(*_: object) -> None:
            raise AssertionError("a photo was opened")

        monkeypatch.setattr("salad.datasets.benchmark.read_photo", opened)
        made = from_radius(refs, plain, 25, table=PhotoTable.read(tmp_path / "t.csv"))
        assert [rows.tolist() for rows in made.positives] == [[0]]
        with pytest.raises(AssertionError, match="opened"):
            from_radius(refs, plain, 25)

    def test_a_missing_folder(self, tmp_path: Path) -> None:
        with pytest.raises(PhotoError):
            read("folder", tmp_path / "r", queries=tmp_path / "q")


class TestRules:
    def test_in_words(self) -> None:
        said = {
            str(rule) for rule in (Radius(25), Frames(2), EveryNth(10, 1), EveryNth(1, 0), SameName(), OwnTable("gt"))
        }
        assert said == {
            "within 25 m (UTM)",
            "within 2 frames, by the numbers in the names",
            "query i, references 10i ± 1",
            "the same index",
            "the pair of one name",
            "by gt",
        }

    @given(
        ours=st.lists(st.integers(0, 30), min_size=1, max_size=12),
        theirs=st.lists(st.integers(0, 30), min_size=1, max_size=12),
        tolerance=st.integers(0, 4),
    )
    def test_frames_by_their_definition(self, ours: list[int], theirs: list[int], tolerance: int) -> None:
        queries, references = (
            PhotoList(Path("x"), [f"cam1_{number}.jpg" for number in side]) for side in (ours, theirs)
        )
        try:
            found = right_by(Frames(tolerance), Sides(references, queries))
        except BenchmarkError:  # numbered by themselves, so that they say nothing of frames
            assert ours == list(range(ours[0], ours[0] + len(ours)))
            return
        for frame, rows in zip(ours, found, strict=True):
            assert rows.tolist() == [row for row, other in enumerate(theirs) if abs(other - frame) <= tolerance]

    @given(queries=st.integers(1, 9), step=st.integers(1, 5), tolerance=st.integers(0, 3))
    def test_every_nth_by_its_definition(self, queries: int, step: int, tolerance: int) -> None:
        ours, theirs = (PhotoList(Path("x"), ["a.jpg"] * count) for count in (queries, queries * step))
        found = right_by(EveryNth(step, tolerance), Sides(theirs, ours))
        for query, rows in enumerate(found):
            assert rows.tolist() == [row for row in range(queries * step) if abs(row - step * query) <= tolerance]

    def test_pairs_by_their_names(self) -> None:
        ours = PhotoList(Path("x"), ["1.jpg", "b/2.jpg", "3.jpg"])
        theirs = PhotoList(Path("y"), ["2.png", "1.png", "a/1.jpg", "4.png"])
        found = right_by(SameName(), Sides(theirs, ours))
        assert [rows.tolist() for rows in found] == [[1, 2], [0], []]

    def test_what_the_set_itself_says_goes_before_any_rule(self) -> None:
        photos, own = PhotoList(Path("x"), ["7.jpg", "8.jpg"]), Ragged.of([np.array([1]), np.array([0])])
        for rule in (Radius(25), Frames(2), EveryNth(1, 0), SameName(), OwnTable()):
            assert right_by(rule, Sides(photos, photos, positives=own)) is own

    def test_a_layout_that_does_not_say_enough(self) -> None:
        photos = PhotoList(Path("x"), ["a.jpg"])
        with pytest.raises(BenchmarkError, match="does not say what is right"):
            right_by(Radius(25), Sides(photos, photos))


def test_a_name_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROTOCOLS, "x", Protocol("x", Radius(1), ()))
    assert protocols.protocol_called("x").rule == Radius(1)
