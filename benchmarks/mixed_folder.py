"""A folder as disks really have them, indexed once: every format, sidecars, what is broken, what is no photo.

    python -m benchmarks.mixed_folder --count 5000 --seed 7

The photos are drawn, each another picture; the model is the fake one, since it is the reading that is looked at. What
is added, skipped, unreadable and passed over must come to the number of files, or the command fails. Hidden files,
sidecars and what lies in folders of thumbnails are no part of it, and are counted apart.
"""

from __future__ import annotations

import argparse
import io
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.machine import conditions, in_a_line
from salad.images.finding import look_through
from salad.index.build import index_photos
from salad.index.index import Index
from salad.models.fake import FakeDescriber

FORMATS = {
    ".jpg": "JPEG",
    ".png": "PNG",
    ".webp": "WEBP",
    ".tif": "TIFF",
    ".bmp": "BMP",
    ".gif": "GIF",
    ".ppm": "PPM",
    ".jp2": "JPEG2000",
    ".avif": "AVIF",
}
NO_PHOTOS = {".mp4": b"\0\0\0\x18ftypmp42", ".txt": b"notes", ".cr2": b"II*\0", ".jxl": b"\xff\x0a", ".ini": b"[a]"}
SIDECAR = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="47,{0}.0N" '
    'exif:GPSLongitude="8,{1}.0E"/></rdf:RDF></x:xmpmeta>'
)


def picture(chance: np.random.Generator, suffix: str) -> bytes:
    """A drawn photo in a format; one in six TIFFs and PNGs is grey of 12 bits."""
    coarse = chance.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = Image.fromarray(coarse).resize((96, 72), Image.Resampling.BICUBIC)
    if suffix in (".tif", ".png") and chance.random() < 1 / 6:
        image = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) << 4)
    file = io.BytesIO()
    image.save(file, FORMATS[suffix])
    return file.getvalue()


def draw(folder: Path, count: int, chance: np.random.Generator) -> Counter[str]:
    """Draw so many files into a folder, and beside them what does not count; say how many of which kind."""
    drawn: Counter[str] = Counter()
    suffixes, last = list(FORMATS), b""
    for number in range(count):
        place = folder / f"{number // 500:02d}"
        place.mkdir(exist_ok=True)
        suffix = suffixes[number % len(suffixes)]
        kind = str(chance.choice(["whole", "broken", "copy", "other"], p=[0.84, 0.06, 0.04, 0.06]))
        if kind == "other":
            suffix, content = list(NO_PHOTOS.items())[number % len(NO_PHOTOS)]
        elif kind == "copy" and last:
            content, suffix = last, ".jpg"
        else:
            content = last = picture(chance, suffix)
        if kind == "broken":
            content = [b"", content[: len(content) // 3], b"<html>404</html>", b"\0" * 900][number % 4]
        name = f"{number:05d}{suffix}"
        (place / name).write_bytes(content)
        drawn[kind] += 1
        if kind == "whole" and chance.random() < 0.2:
            (place / f"{name}.xmp").write_text(SIDECAR.format(number % 60, number % 59))
            drawn["sidecar"] += 1
        if number % 100 == 0:
            thumbnails = place / "@eaDir" / name
            thumbnails.mkdir(parents=True)
            (thumbnails / "SYNOPHOTO_THUMB_M.jpg").write_bytes(content)
            drawn["thumbnail"] += 1
    return drawn


def main() -> None:
    """Draw the folder, index it, and see whether the counts add up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000, help="files, sidecars and thumbnails not counted")
    parser.add_argument("--seed", type=int, default=7)
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        disk = Path(name, "disk")
        disk.mkdir()
        drawn = draw(disk, wanted.count, np.random.default_rng(wanted.seed))
        begun = time.perf_counter()
        found = look_through([disk])
        model = FakeDescriber()
        with Index.create(Path(name, "i"), dim=model.dim, fingerprint=model.fingerprint, model=model.name) as index:
            result = index_photos(found.photos, index, model)
        seconds = time.perf_counter() - begun
    files = [each for each in found.passed_over if os.path.splitext(each.path)[1] in NO_PHOTOS]  # noqa: PTH122  # texts
    folders = len(found.passed_over) - len(files)
    total = result.added + result.skipped + len(result.unreadable) + len(files)
    print(f"drawn: {', '.join(f'{count:,} {kind}' for kind, count in sorted(drawn.items()))}")
    print(
        f"{result.added:,} added + {result.skipped:,} skipped + {len(result.unreadable):,} unreadable + "
        f"{len(files):,} passed over = {total:,} of {wanted.count:,} files; folders of thumbnails left out: {folders}"
    )
    print(f"{result.added - result.unplaced:,} with a position, {seconds:.0f} s")
    print(in_a_line(conditions("pillow", "numpy", seed=wanted.seed, count=wanted.count)))
    if total != wanted.count or len(result.unreadable) < drawn["broken"]:
        raise SystemExit("the counts do not add up")


if __name__ == "__main__":
    main()
