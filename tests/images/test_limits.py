"""What a photo may cost: time and memory have an end for one photo as for a million, and honest large ones are read.

The time is made short here, so that the suite is; `python -m benchmarks.speed.limits` measures with the real one.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import salad
from salad.errors import PhotoError
from salad.images import decode, worker_process, workers
from salad.images.workers import Pool, Workers
from salad.index.index import Index
from salad.models.fake import FakeDescriber
from tests.images.hostile import HOSTILE, jpeg_with, many_scans

SIZE = (32, 24, "bilinear")

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timers that end a process")

# A worker process in which small photos have a second, and which takes memory when it is asked to.
SHORT = """
import pathlib
import numpy
from salad.images import worker_process as reading

reading.SECONDS = 1.0

def highest(path):
    status = pathlib.Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else ["VmHWM: 0"]
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

def take(path, share, size):
    reading.LIMITS.grant(share)
    with reading.naming(path):
        return len(numpy.empty(size, "u1"))  # taken, and not touched

reading.TASKS |= {"highest": highest, "take": take}
reading.main()
"""
SLOW = {
    "fill bytes.jpg", "fill bytes that end.jpg", "blanks in the header.ppm", "a comment without end.ppm",
    "800 segments of EXIF.jpg",
}  # fmt: skip


@pytest.fixture
def short() -> Iterator[Pool]:
    made = Pool(SHORT)
    yield made
    made.close()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_photo_has_an_end(short: Pool, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    HOSTILE[name](path)
    with Workers(1, pool=short) as crew:
        try:
            said = crew.read(path, SIZE).trouble
        except PhotoError as error:
            said = str(error)
        assert not said or (said.startswith(str(path)) and "\n" not in said)
        assert "crashes" not in said
        if name in SLOW:
            assert "took over" in said
        assert crew.ask("highest", path) < 2_000_000_000
    path.unlink()  # some are long


def test_so_it_is_for_one_photo_by_whatever_road(short: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "SHARED", short)
    path, model = tmp_path / "fill bytes.jpg", FakeDescriber()
    HOSTILE["fill bytes.jpg"](path)
    with Index.create(tmp_path / "i", dim=model.dim, fingerprint=model.fingerprint, model=model.name) as index:
        for road in (
            lambda: salad.locate(path, index=index, model=model),
            lambda: model.describe([path]),
            lambda: Workers(1).look(path),
        ):
            with pytest.raises(PhotoError, match=r"fill bytes\.jpg took over \d+ s to read"):
                road()
        (said,) = salad.index_photos([path], index, model).unreadable
        assert "fill bytes.jpg took over" in said


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="only Linux keeps a process to its memory")
def test_memory_has_an_end_by_the_size_that_the_header_says(short: Pool, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    with Workers(1, pool=short) as crew:
        assert crew.ask("take", path, 0.0, 1_800_000_000)
        with pytest.raises(PhotoError, match="needs more memory than there is"):
            crew.ask("take", path, 0.0, 2_000_000_000)
        assert crew.ask("take", path, 1.0, 2_300_000_000)
        with pytest.raises(PhotoError, match="needs more memory than there is"):
            crew.ask("take", path, 1.0, 2_500_000_000)


def test_what_is_granted_grows_with_the_photo(tmp_path: Path) -> None:
    seen: list[float] = []
    for side in (1000, 10_000):
        path = tmp_path / f"{side}.png"
        Image.new("1", (side, side)).save(path)
        decode.decode(path, 8, 8, grant=seen.append)
    assert seen == [pytest.approx(1e6 / decode.MAX_PIXELS), pytest.approx(1e8 / decode.MAX_PIXELS)]
    Image.new("RGB", (1000, 1000)).save(tmp_path / "a.webp")
    decode.open_rgb(tmp_path / "a.webp", grant=seen.append)
    assert seen[-1] == pytest.approx(2 * seen[0])  # half as many pixels are opened


def test_a_large_honest_photo_is_read(tmp_path: Path) -> None:
    path = tmp_path / "large.jpg"
    Image.new("L", (13_000, 13_000), 77).save(path)
    with Workers(1) as crew:
        assert np.abs(crew.decode(path, *SIZE).astype(int) - 77).max() <= 2


def test_scans_are_counted_as_far_as_the_photo_goes(tmp_path: Path) -> None:
    """Neither a preview's nor what lies behind the end is the photo's."""
    plain = many_scans(3)
    preview = many_scans(90)
    segments = b"".join(
        b"\xff\xe2" + (2 + len(part)).to_bytes(2, "big") + part
        for part in (preview[at : at + 60_000] for at in range(0, len(preview), 60_000))
    )
    behind = b"\xff\xda\0\x02" * 1000
    assert segments.count(b"\xff\xda") > 80
    for content in (plain + behind, plain[:2] + segments + plain[2:] + behind):
        (tmp_path / "a.jpg").write_bytes(content)
        assert decode.decode(tmp_path / "a.jpg", 8, 8).shape == (8, 8, 3)
    (tmp_path / "b.jpg").write_bytes(many_scans(100))
    with pytest.raises(PhotoError, match="over 100 passes over its pixels"):
        decode.decode(tmp_path / "b.jpg", 8, 8)


@pytest.mark.parametrize("read", [worker_process.read, worker_process.look, worker_process.decode])
def test_a_file_longer_than_the_limit_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: object
) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg_with(b""))
    monkeypatch.setattr(decode, "LONGEST", path.stat().st_size - 1)
    if read is worker_process.look:  # such a photo has no EXIF, as one that is damaged has none
        assert worker_process.look(path).where is None
        return
    with pytest.raises(PhotoError, match="it is longer than"):
        read(path, *((SIZE,) if read is worker_process.read else SIZE))
