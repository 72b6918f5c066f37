"""Quantizing a model on somebody's own photos, and refusing what no longer recognises places.

Photos are drawn and split: on some the range of the model's numbers is learnt, on others both models are judged. Where
enough of the latter have positions, a photo is recognised if the nearest of the others is one taken within 25 m. Where
they have none, nobody can say what is right but of a photo itself: then each must be found by a window of itself,
darkened or lightened. That is easier than a place, so it says less; but a model that was spoilt fails there too.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from salad.datasets.benchmark import Benchmark
from salad.datasets.compact_lists import positions
from salad.datasets.neighbours import near_on_earth
from salad.errors import ModelError, PhotoError
from salad.evaluation.evaluate_benchmark import evaluate
from salad.images.photo import Photo, read_photo
from salad.images.photo_table import PhotoTable
from salad.models.describer import Describer
from salad.models.quantize import Reduced, quantized

LEARNT_ON, JUDGED_ON = 300, 1000  # photos, at most
FEWEST = 100  # queries: of fewer, one alone is more than a point
POINT = 1.0  # percent of R@1 that may be lost
RADIUS = 25.0  # metres, as the field counts a place
WINDOW = 0.5  # of each side, that a photo is to be found by
LIGHT = (0.6, 1.4)  # times as bright

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Kept:
    """What became of a model's recognition.

    Attributes:
        before: R@1 in percent of the model in float32.
        after: R@1 of the quantized one.
        queries: How many photos were asked.
        rule: What was right.
        unreadable: A sentence for each photo that was drawn and passed over.
    """

    before: float
    after: float
    queries: int
    rule: str
    unreadable: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"R@1 {self.after:.1f} % where it was {self.before:.1f} % ({self.queries} photos held out, {self.rule})"


def quantize(
    model: Describer,
    photos: Sequence[Path],
    *,
    precision: Reduced = "int8",
    table: PhotoTable | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Describer, Kept]:
    """A model in another precision that recognises as well, within a point, on photos it was not made with.

    Args:
        model: In float32, opened with the engine `openvino`.
        photos: Of the kind it is to recognise; some are drawn.
        precision: What to compute in.
        table: Positions of photos that carry none themselves.
        seed: Of which photos are drawn, and of windows and light.
        progress: Told how many photos are described, and of how many, by one model after the other.

    Raises:
        ModelError: If too few photos can be read, or more than a point is lost; or the model runs in another engine.
        MissingExtraError: If OpenVINO or NNCF is not installed.
    """
    chance = np.random.default_rng(seed)
    passed_over: list[str] = []
    readable = _read([photos[row] for row in chance.permutation(len(photos))], model, passed_over)
    # Half to learn on where photos are few; bf16 has nothing to learn.
    learning = min(LEARNT_ON, len(photos) // 2) if precision == "int8" else 0
    learnt = [pixels for _, pixels in islice(readable, learning)]
    held_out = list(islice(readable, JUDGED_ON))
    if len(held_out) < FEWEST:
        raise ModelError(
            f"{len(photos)} photos are too few, {len(passed_over)} of them cannot be read: "
            f"{FEWEST} must be left to judge by, so give {2 * FEWEST} or more"
        )
    made = quantized(model, np.array(learnt), precision=precision)
    with tempfile.TemporaryDirectory(prefix="salad-") as scratch:
        benchmark = _places(held_out, table) or _windows(held_out, Path(scratch), chance)
        total = len(benchmark.references) + len(benchmark.queries)

        def recall(of: Describer, described: int) -> float:
            def report(done: int, _: int) -> None:
                if progress is not None:
                    progress(described + done, 2 * total)

            return evaluate(benchmark, of, ks=(1,), seed=seed, progress=report).recall[1]

        before, after = recall(model, 0), recall(made, total)
    kept = Kept(before, after, benchmark.counted, benchmark.protocol, tuple(passed_over))
    if kept.before - kept.after > POINT:
        raise ModelError(
            f"{model.name} in {precision} has {kept}: more than a point is lost, so it is not written; give more photos"
            + (", or take --precision bf16" if precision == "int8" else "")
        )
    provenance = f"{made.config.provenance}; {kept}"
    return Describer(replace(made.config, provenance=provenance), made.engine, engine_choice=made.engine_choice), kept


Read = tuple[Path, UInt8[np.ndarray, "height width 3"]]


def _read(photos: Sequence[Path], model: Describer, passed_over: list[str]) -> Iterator[Read]:
    """Each photo that can be read, with its pixels as the model takes them; a list gets a sentence for the others."""
    for path in photos:
        try:
            yield path, model.squeezed([path])[0]
        except PhotoError as error:
            passed_over.append(str(error))


def _places(held_out: Sequence[Read], table: PhotoTable | None) -> Benchmark | None:
    """Every second photo with a position asked of the others; None where too few have another near them."""
    known = [read_photo(path, table) for path, _ in held_out]
    placed = [photo for photo in known if photo.where is not None]
    queries, references = placed[::2], placed[1::2]  # by chance, as they were drawn
    if not references:
        return None
    near = near_on_earth(positions(queries), positions(references), RADIUS)
    made = Benchmark("held out", f"right within {RADIUS:g} m", references, queries, near)
    return made if made.counted >= FEWEST else None


def _windows(held_out: Sequence[Read], folder: Path, chance: np.random.Generator) -> Benchmark:
    """Each photo asked for by a window of itself in another light; the windows are written to a folder."""
    queries = []
    for number, (_, pixels) in enumerate(held_out):
        height, width = (max(1, round(side * WINDOW)) for side in pixels.shape[:2])
        top, left = chance.integers(pixels.shape[0] - height + 1), chance.integers(pixels.shape[1] - width + 1)
        light = chance.uniform(*LIGHT)
        window = np.clip(pixels[top : top + height, left : left + width] * light, 0, 255).astype(np.uint8)
        queries.append(Photo(folder / f"{number}.png"))
        Image.fromarray(window).save(queries[-1].path)
    references = [Photo(path) for path, _ in held_out]
    found = [np.array([row], np.int64) for row in range(len(references))]
    return Benchmark("held out", "each by a window of itself", references, queries, found)
