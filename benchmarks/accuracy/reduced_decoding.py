"""What decoding large JPEGs reduced changes: photos of the evaluation sets, and descriptors of made photos.

    python -m benchmarks.accuracy.reduced_decoding [MODEL ...] [--data ../shared/data/eval]

Counts, of each set, the photos that a model sees with other bytes than a decode in full would give it: a figure
measured before everybody decoded reduced can only move where that is not 0. Those photos are small; so six photos
of 1920 x 1440, made of soft noise, say how far apart the descriptors of the two ways are.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.accuracy.recall import SETS, describer
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import EVAL, SHIPPED, benchmark_parser
from salad.images.decode import decode, open_rgb, squeeze
from salad.images.finding import find_photos
from salad.models.describer import DescriberLike

SEED, MADE, SIZE = 0, 6, (1920, 1440)


def changed(model: DescriberLike, photo: Path) -> bool:
    """Whether the model sees other bytes than by a decode in full."""
    to = model.preprocessing
    whole = squeeze(open_rgb(photo), to.height, to.width, to.resample)
    return not np.array_equal(whole, decode(photo, to.height, to.width, to.resample))


def cosines(model: DescriberLike) -> list[float]:
    """Between the descriptors of made photos, decoded reduced and in full."""
    draw = np.random.default_rng(SEED)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(MADE):
            coarse = draw.integers(0, 256, (45, 60, 3), dtype=np.uint8)
            grain = draw.normal(0, 12, (SIZE[1], SIZE[0], 3))
            pixels = np.asarray(Image.fromarray(coarse).resize(SIZE, Image.Resampling.BICUBIC)) + grain
            buffer = io.BytesIO()
            Image.fromarray(pixels.clip(0, 255).astype(np.uint8)).save(buffer, "JPEG", quality=90)
            photo = Path(folder, f"{number}.jpg")
            photo.write_bytes(buffer.getvalue())
            reduced, whole = model.describe([photo, open_rgb(photo)])
            found.append(float(reduced @ whole))
    return found


def main() -> None:
    asked = benchmark_parser(__doc__, models=SHIPPED, data=EVAL).parse_args()
    print(in_a_line(conditions("pillow", seed=SEED)))
    sets = {
        one.name: find_photos(asked.data / one.name / side for side in (one.references, one.queries)) for one in SETS
    }
    print(f"| model | {' | '.join(sets)} | cosine, made photos of 1920 x 1440 |")
    print("|---" * (len(sets) + 2) + "|")
    for name in asked.models:
        model = describer(name)
        counts = []
        for photos in sets.values():
            counts.append(f"{sum(changed(model, photo) for photo in photos)} of {len(photos)}")
        near = cosines(model)
        print(f"| {name} | {' | '.join(counts)} | {min(near):.4f} to {max(near):.4f} |", flush=True)


if __name__ == "__main__":
    main()
