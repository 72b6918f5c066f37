"""Descriptors and rankings of other methods: judged as our own, checked before, refused in sentences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation.evaluate_benchmark import EvalSettings, evaluate_descriptors, evaluate_rankings, rank
from salad.evaluation.external import write_rankings
from salad.images.photo import Photo
from salad.search.base import ArrayRows


def benchmark(folder: Path, *, names: tuple[str, str] = ("r{}.jpg", "q{}.jpg")) -> Benchmark:
    references, queries = (
        [Photo(folder / side / name.format(number)) for number in range(count)]
        for side, name, count in (("database", names[0], 6), ("queries", names[1], 4))
    )
    return Benchmark("set", "p", references, queries, [np.array([number]) for number in range(4)])


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, Path]:
    rng = np.random.default_rng(0)
    files = tmp_path / "refs.npy", tmp_path / "queries.npy"
    for path, count in zip(files, (6, 4), strict=True):
        rows = rng.standard_normal((count, 5)).astype(np.float32)
        np.save(path, rows / np.linalg.norm(rows, axis=1, keepdims=True))
    return files


class TestDescriptors:
    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
    def test_judged_as_our_own(self, tmp_path: Path, saved: tuple[Path, Path], dtype: type) -> None:
        references, queries = (np.load(path).astype(dtype) for path in saved)
        for path, rows in zip(saved, (references, queries), strict=True):
            np.save(path, rows)
        set_ = benchmark(tmp_path)
        result = evaluate_descriptors(set_, *saved, name="peer")
        ranked = rank(ArrayRows(queries), ArrayRows(references), k=20).rows
        hits = np.argwhere(ranked == np.arange(4)[:, None])[:, 1]  # each query has one right reference
        assert result.recall == {k: 100.0 * float(np.mean(hits < k)) for k in (1, 5, 10, 20)}
        assert (result.model, result.fingerprint) == ("peer", "")
        assert result.notes == ("descriptors from outside, of length 1: ranked by cosine",)
        assert result.precision_recall is not None

    def test_other_lengths_are_said(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        np.save(saved[0], 3 * np.load(saved[0]))
        (note,) = evaluate_descriptors(benchmark(tmp_path), *saved, name="peer").notes
        assert "not of length 1 (1 to 3)" in note
        assert "dot product" in note

    def test_refusals(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        set_ = benchmark(tmp_path)
        with pytest.raises(BenchmarkError, match=r"queries\.npy has 4 rows, but there are 6 references"):
            evaluate_descriptors(set_, saved[1], saved[1], name="peer")
        with pytest.raises(BenchmarkError, match="gone"):
            evaluate_descriptors(set_, tmp_path / "gone.npy", saved[1], name="peer")
        rows = np.load(saved[1])
        np.save(saved[1], rows[:, :4])
        with pytest.raises(BenchmarkError, match=r"5 numbers a row and .* 4"):
            evaluate_descriptors(set_, *saved, name="peer")
        rows[2, 0] = np.nan
        np.save(saved[1], rows)
        with pytest.raises(BenchmarkError, match=r"row 2 .*queries\.npy holds NaN"):
            evaluate_descriptors(set_, *saved, name="peer")
        np.save(saved[1], np.array([{}], dtype=object))  # a pickle is never opened
        with pytest.raises(BenchmarkError, match="holds object"):
            evaluate_descriptors(set_, *saved, name="peer")


class TestRankings:
    def test_written_and_read_again(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        set_ = benchmark(tmp_path)
        ours = evaluate_descriptors(set_, *saved, name="peer")
        write_rankings(ours, tmp_path / "ranked.txt")
        lines = (tmp_path / "ranked.txt").read_text(encoding="utf-8").splitlines()
        assert [line.split()[0] for line in lines] == ["q0", "q1", "q2", "q3"]
        theirs = evaluate_rankings(set_, tmp_path / "ranked.txt", name="again")
        assert theirs.recall == ours.recall
        assert [one.matches for one in theirs.per_query] == [one.matches for one in ours.per_query]
        assert theirs.precision_recall is None  # nobody told scores

    def test_names_that_only_their_folders_tell_apart(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        set_ = benchmark(tmp_path, names=("{}/x.jpg", "{}/y.jpg"))
        ours = evaluate_descriptors(set_, *saved, name="peer")
        write_rankings(ours, tmp_path / "ranked.txt")
        assert (tmp_path / "ranked.txt").read_text(encoding="utf-8").startswith("0/y.jpg ")
        assert evaluate_rankings(set_, tmp_path / "ranked.txt", name="n").recall == ours.recall
        (tmp_path / "ranked.txt").write_text("y x\n", encoding="utf-8")
        with pytest.raises(BenchmarkError, match="'y', which several queries are called"):
            evaluate_rankings(set_, tmp_path / "ranked.txt", name="n")

    def test_a_space_cannot_be_written(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        ours = evaluate_descriptors(benchmark(tmp_path, names=("r {}.jpg", "q{}.jpg")), *saved, name="peer")
        with pytest.raises(BenchmarkError, match="has a space in its name"):
            write_rankings(ours, tmp_path / "ranked.txt")
        assert not (tmp_path / "ranked.txt").exists()

    def test_short_lists_and_queries_that_do_not_count(self, tmp_path: Path) -> None:
        ranked = tmp_path / "ranked.txt"
        ranked.write_text("q0 r0 r1 r2 r3 r4\n\nq1 r0 r1.jpg\nother r0\nq2\nq3 r0 r1 r2\n", encoding="utf-8")
        result = evaluate_rankings(benchmark(tmp_path), ranked, name="peer")
        assert result.recall == {1: 25.0, 5: 50.0}  # nobody asked it for ten
        assert [one.first_right for one in result.per_query] == [1, 2, None, None]
        assert len(result.notes) == 2
        assert "1 lines of ranked.txt are of queries that the protocol leaves out" in result.notes[1]
        ranked.write_text("q0\nq1\nq2\nq3\n", encoding="utf-8")
        assert evaluate_rankings(benchmark(tmp_path), ranked, name="peer", settings=EvalSettings((5,))).recall == {
            1: 0.0
        }

    @pytest.mark.parametrize(
        ("text", "named"),
        [
            ("q0 r0\n", "no line for 3 of 4 queries"),
            ("q0 r0\nq0 r1\n", "a second time"),
            ("q0 r0 r9\n", "'r9', which is no reference"),
            ("q0 r0 r0.jpg\n", "a reference twice"),
        ],
    )
    def test_refusals(self, tmp_path: Path, text: str, named: str) -> None:
        (tmp_path / "ranked.txt").write_text(text, encoding="utf-8")
        with pytest.raises(BenchmarkError, match=named):
            evaluate_rankings(benchmark(tmp_path), tmp_path / "ranked.txt", name="peer")

    def test_files_that_are_not_there(self, tmp_path: Path, saved: tuple[Path, Path]) -> None:
        with pytest.raises(BenchmarkError, match="cannot be read"):
            evaluate_rankings(benchmark(tmp_path), tmp_path / "gone.txt", name="peer")
        ours = evaluate_descriptors(benchmark(tmp_path), *saved, name="peer")
        with pytest.raises(BenchmarkError, match="cannot be written"):
            write_rankings(ours, tmp_path / "no" / "such.txt")
