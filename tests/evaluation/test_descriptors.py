"""A second evaluation describes nothing; what is damaged or cut short counts for nothing."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import load_file

from salad.datasets.benchmark import Benchmark
from salad.errors import BenchmarkError
from salad.evaluation import descriptors
from salad.evaluation.descriptors import DescriptorCache, describe_sides
from salad.evaluation.evaluate_benchmark import evaluate
from salad.images.decode import DECODER
from salad.images.photo import Photo, content_hash
from salad.models.fake import FakeDescriber
from tests.swapping import WAYS, at_each_step


@dataclass(frozen=True)
class Counting(FakeDescriber):
    """Counts the photos it describes."""

    seen: list[str] = field(default_factory=list)

    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> Any:
        self.seen.extend(hashlib.sha256(photo).hexdigest() for photo in photos)
        return super().describe(photos, batch_size=batch_size)


@pytest.fixture
def drive(tmp_path: Path) -> Benchmark:
    rng, sides = np.random.default_rng(0), []
    for side, count in (("r", 7), ("q", 4)):
        sides.append([Photo(tmp_path / side / f"{number}.png") for number in range(count)])
        (tmp_path / side).mkdir()
        for photo in sides[-1]:
            Image.fromarray(rng.integers(0, 255, (24, 24, 3), dtype=np.uint8)).save(photo.path)
    shutil.copy(tmp_path / "r" / "3.png", tmp_path / "r" / "5.png")  # two files of one content
    return Benchmark("b", "frames ±0", *sides, [np.array([number]) for number in range(4)])


@pytest.mark.parametrize("photos", [1, 3, 1000])
def test_the_second_time_nothing_is_described(
    drive: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photos: int
) -> None:
    monkeypatch.setattr(descriptors, "_PHOTOS", photos)
    plain = evaluate(drive, FakeDescriber())
    first, second = Counting(), Counting()
    one = evaluate(drive, first, cache=tmp_path / "cache", batch_size=2)
    two = evaluate(drive, second, cache=tmp_path / "cache")
    assert len(first.seen) == 10  # eleven photos, of which two are one
    assert second.seen == []
    for result in (one, two):
        assert result.recall == plain.recall
        for ours, due in zip(result.per_query, plain.per_query, strict=True):
            assert ours.matches == due.matches
            assert ours.scores == pytest.approx(due.scores, rel=1e-6)


def test_files_are_safetensors_and_nothing_else_is_left(drive: Benchmark, tmp_path: Path) -> None:
    model = FakeDescriber(dim=5)
    describe_sides(drive, model, batch_size=4, cache=tmp_path / "cache")
    (path,) = (tmp_path / "cache").rglob("*.*")
    assert path.parent.name == f"{model.fingerprint}-decoder{DECODER}"
    held = load_file(path)
    assert held["contents"].shape == (10, 16)
    paths = [photo.path for photo in (*drive.references, *drive.queries) if photo.path.name != "5.png"]
    assert held["descriptors"] == pytest.approx(model.describe(paths), abs=1e-6)


def test_rows_come_in_the_order_of_the_photos_whatever_the_block(drive: Benchmark, tmp_path: Path) -> None:
    model = FakeDescriber(dim=3)
    DescriptorCache(tmp_path, model).sides(drive.queries, drive.references[4:])
    shuffled = [drive.references[row] for row in (5, 0, 3, 6, 1, 1, 2)]
    rows, _ = DescriptorCache(tmp_path, model).sides(shuffled, drive.queries)
    due = model.describe([photo.path for photo in shuffled])
    spare = np.empty((7, 3), np.float32)
    for size in (1, 2, 7):
        blocks = [rows.block(start, min(start + size, 7), spare).copy() for start in range(0, 7, size)]
        assert np.concatenate(blocks) == pytest.approx(due, abs=1e-6)
    assert rows.take(np.array([6, 0, 0])) == pytest.approx(due[[6, 0, 0]], abs=1e-6)
    assert rows.take(np.arange(0)).shape == rows.block(7, 7, spare).shape == (0, 3)
    assert (len(rows), rows.dim, rows.dtype, rows.longest) == (7, 3, np.float32, None)


def test_a_changed_photo_and_another_model_are_described(drive: Benchmark, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    evaluate(drive, Counting(), cache=cache)
    other = Counting(seed=1)
    evaluate(drive, other, cache=cache)
    assert len(other.seen) == 10
    Image.new("RGB", (30, 30), (9, 200, 9)).save(drive.queries[2].path)
    again = Counting()
    seen: list[tuple[int, int]] = []
    evaluate(drive, again, cache=cache, progress=lambda done, total: seen.append((done, total)))
    assert len(again.seen) == 1
    assert seen[-1] == (11, 11)


@pytest.mark.parametrize("harm", ["flip", "cut", "empty", "head", "grow", "other"])
def test_a_damaged_file_counts_for_nothing(drive: Benchmark, tmp_path: Path, harm: str) -> None:
    cache = tmp_path / "cache"
    due = evaluate(drive, Counting(), cache=cache)
    (path,) = cache.rglob("*.safetensors")
    content = bytearray(path.read_bytes())
    if harm == "flip":
        content[-9] ^= 64
    elif harm == "cut":
        del content[-40:]
    elif harm == "empty":
        content.clear()
    elif harm == "head":
        content[:8] = (1 << 60).to_bytes(8, "little")
    elif harm == "grow":
        content += b"x"
    else:
        content[8:12] = b"[1]]"
    path.write_bytes(bytes(content))
    again = Counting()
    result = evaluate(drive, again, cache=cache)
    assert len(again.seen) == 10
    assert [one.matches for one in result.per_query] == [one.matches for one in due.per_query]
    third = Counting()
    evaluate(drive, third, cache=cache)
    assert third.seen == []  # it was written anew


def test_what_was_described_before_an_end_stays(
    drive: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(descriptors, "_PHOTOS", 2)
    hole = replace(drive, queries=[*drive.queries[:3], Photo(tmp_path / "gone.png")])
    with pytest.raises(BenchmarkError, match=r"no figure.*gone\.png"):
        evaluate(hole, Counting(), cache=tmp_path / "cache")
    again = Counting()
    evaluate(drive, again, cache=tmp_path / "cache")
    assert len(again.seen) <= 3
    assert not list((tmp_path / "cache").rglob(".*"))


def test_what_another_decoder_gave_is_not_found_again(drive: Benchmark, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    evaluate(drive, Counting(), cache=cache)
    (here,) = cache.iterdir()
    here.rename(cache / FakeDescriber().fingerprint)  # where descriptors lay before decoders were numbered
    anew = Counting()
    evaluate(drive, anew, cache=cache)
    assert len(anew.seen) == 10


def test_a_cache_in_which_nothing_can_be_read_does_not_wait(drive: Benchmark, tmp_path: Path) -> None:
    model = FakeDescriber()
    describe_sides(drive, model, cache=tmp_path)
    (file,) = tmp_path.rglob("*.safetensors")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(BenchmarkError, match="it is no regular file"):
        describe_sides(drive, model, cache=tmp_path)


def test_a_cache_that_cannot_be(drive: Benchmark, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(BenchmarkError, match="cannot be used"):
        evaluate(drive, FakeDescriber(), cache=tmp_path / "file")


def test_a_file_that_is_gone_while_it_is_read(drive: Benchmark, tmp_path: Path) -> None:
    rows, _ = describe_sides(drive, FakeDescriber(), cache=tmp_path / "cache")
    (path,) = (tmp_path / "cache").rglob("*.safetensors")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(BenchmarkError, match="cannot be read any more"):
        rows.take(np.arange(7))
    path.unlink()
    with pytest.raises(BenchmarkError, match="cannot be read"):
        rows.take(np.arange(7))


def test_a_disk_that_takes_nothing(drive: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(descriptors, "write_whole", full)
    with pytest.raises(BenchmarkError, match="No space left"):
        evaluate(drive, FakeDescriber(), cache=tmp_path / "cache")


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("cached", [False, True])
def test_a_photo_is_opened_once(
    drive: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cached: bool
) -> None:
    opened: list[str] = []
    honest = os.open

    def counted(path: Any, *arguments: Any, **settings: Any) -> Any:
        opened.append(os.fspath(path))
        return honest(path, *arguments, **settings)

    monkeypatch.setattr(os, "open", counted)
    for _ in range(2):
        opened.clear()
        describe_sides(drive, FakeDescriber(), cache=tmp_path / "cache" if cached else None)
        assert [path for path in opened if path.endswith(".png")] == [
            str(photo.path) for photo in (*drive.references, *drive.queries)
        ]


def test_what_is_decoded_again_after_a_wrong_guess_is_described_all_the_same(drive: Benchmark, tmp_path: Path) -> None:
    half = replace(drive, references=drive.references[:4], queries=drive.queries[:1], positives=drive.positives[:1])
    describe_sides(half, FakeDescriber(), cache=tmp_path / "cache")
    again = Counting()
    rows, _ = describe_sides(drive, again, cache=tmp_path / "cache", batch_size=1)
    assert len(again.seen) == 5
    due = FakeDescriber().describe([photo.path for photo in drive.references])
    np.testing.assert_allclose(rows.take(np.arange(7)), due, atol=1e-6)


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("known", [False, True])
def test_a_photo_saved_anew_meanwhile_is_kept_as_one_version(
    drive: Benchmark, tmp_path: Path, way: Callable[[Path, bytes], None], known: bool
) -> None:
    """At whatever step of ours, and also where the cache guesses that it knows the photo."""
    path, versions = drive.references[2].path, {}
    for photo in (drive.references[2], drive.references[6]):
        versions[content_hash(photo.path)] = photo.path.read_bytes(), FakeDescriber().describe([photo.path])[0]
    first, second = (content for content, _ in versions.values())
    half = replace(drive, references=drive.references[:2], queries=drive.queries[:1], positives=drive.positives[:1])
    short = replace(drive, references=drive.references[:4], queries=drive.queries[:1], positives=drive.positives[:1])
    for number, swapping in enumerate(at_each_step(path, first, second, way)):
        cache = tmp_path / f"cache {number}"
        if known:
            describe_sides(half, FakeDescriber(), cache=cache)
        with swapping:
            described = describe_sides(short, FakeDescriber(), cache=cache, batch_size=1)[0].take(np.array([2]))[0]
        kept = {
            key.tobytes().hex(): row
            for file in (cache.glob("*/*"))
            for key, row in zip(*(load_file(file)[name] for name in ("contents", "descriptors")), strict=True)
        }
        found = versions.keys() & kept.keys()
        assert len(found) == 1
        for content in found:
            np.testing.assert_allclose(kept[content], versions[content][1], atol=1e-6)
            np.testing.assert_allclose(described, versions[content][1], atol=1e-6)
