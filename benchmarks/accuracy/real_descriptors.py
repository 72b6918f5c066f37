"""Descriptors of real photos, and as many more like them as an index of a million needs.

    python -m benchmarks.accuracy.real_descriptors FOLDER [--model salad-lite] [--crops 3000]

describes the training photos, crops of some of them and the evaluation photos once, and keeps them in FOLDER: rows of
float16 in `train.npy`, `crops.npy` and a file for each evaluation set, with the photos' names beside them.

There are no million photos here. So `Distractors` makes rows of two photos each: every cluster of the descriptor, and
the scene, is taken whole from one of the two, most of them from the first, and a little noise is added. Such rows
leave the paths that real photos keep to: some of what clusters have in common is lost, so they are rather harder to
compress than as many photos would be, and the many rows of one first photo are harder to tell apart. Whoever asks
takes care that no photo of a query's own place is made use of: what is near a query then is a real photo.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numkong
import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.recall import SETS
from benchmarks.options import EVAL, TRAIN, benchmark_parser
from salad.images.decode import Pixels, decode, open_rgb, squeeze
from salad.images.finding import find_photos
from salad.models.describer import Describer
from salad.models.model_folder import load

SEED = 0
SIDES = (0.6, 0.9)  # of a crop, as parts of the photo's
_SOME = 512  # photos described before the file grows

Half = npt.NDArray[np.float16]


@dataclass(frozen=True)
class Described:
    """Photos and their descriptors.

    Attributes:
        names: Paths below the folder they were found in.
        rows: `[N, dim]` of length 1.
    """

    names: list[str]
    rows: Half

    @classmethod
    def read(cls, folder: Path, name: str) -> Described:
        """What `main` kept under a name: `train`, `crops`, or an evaluation set's and `-references` or `-queries`."""
        return cls(json.loads((folder / f"{name}.json").read_text()), np.load(folder / f"{name}.npy"))


@dataclass(frozen=True)
class Layout:
    """How a descriptor is made up: the scene's numbers, those of each cluster, feature by feature, then each cell's.

    Only salad-lite-route's has cells, number by number.
    """

    scene: int = 256
    clusters: int = 128
    features: int = 64
    cells: int = 0
    cell: int = 32  # numbers of one

    @property
    def parts(self) -> npt.NDArray[np.int64]:
        """Which part each number belongs to, of `1 + clusters + cells`: the scene is part 0."""
        scene, clusters = np.zeros(self.scene, np.int64), np.arange(1, 1 + self.clusters)
        cells = np.arange(1 + self.clusters, 1 + self.clusters + self.cells)
        return np.concatenate([scene, np.tile(clusters, self.features), np.repeat(cells, self.cell)])


class Distractors:
    """Rows like those of real photos, as many as are asked for, made of them.

    Args:
        rows: `[N, dim]` of real photos, none of which shows what is searched.
        layout: Of these descriptors.
        second: Share of the clusters that is taken from the second photo.
        noise: Length of the noise that is added.
        seed: Of all that is drawn.
    """

    def __init__(
        self, rows: Half, *, layout: Layout, second: float = 0.25, noise: float = 0.2, seed: int = SEED
    ) -> None:
        self._rows, self._layout, self._second, self._noise, self._seed = rows, layout, second, noise, seed

    def blocks(self, count: int, *, step: int = 1000) -> Iterator[Half]:
        """`count` of them, `step` at a time; the same ones each time."""
        rng, dim = np.random.default_rng(self._seed), self._rows.shape[1]
        of_number = self._layout.parts
        for start in range(0, count, step):
            some = min(step, count - start)
            first, second = rng.integers(len(self._rows), size=(2, some))
            taken = rng.random((some, of_number.max() + 1), dtype=np.float32) < self._second
            made = np.where(taken[:, of_number], self._rows[second], self._rows[first])
            made = np.asarray(numkong.astype(made, "float32"))  # numpy takes ten times as long
            made += rng.standard_normal((some, dim), dtype=np.float32) * np.float32(self._noise / np.sqrt(dim))
            made /= np.sqrt(np.einsum("ij,ij->i", made, made))[:, None]
            yield np.asarray(numkong.astype(made, "float16"))


def describe(model: Describer, names: Sequence[str], pixels: Callable[[str], Pixels], to: Path) -> None:
    """Describe photos and keep the rows as `to`.npy; what was described before an interrupt is not done again."""
    part = to.with_suffix(".part")
    row = model.dim * 2
    done = part.stat().st_size // row if part.is_file() else 0
    with part.open("r+b" if done else "wb") as file:
        file.truncate(done * row)
        file.seek(done * row)
        for number in range(done, len(names)):
            file.write(model.describe([pixels(names[number])], batch_size=1).astype(np.float16).tobytes())
            if number % _SOME == 0:
                print(f"{to.name}: {number} of {len(names)}", flush=True)
    np.save(to.with_suffix(".npy"), np.fromfile(part, np.float16).reshape(-1, model.dim))
    to.with_suffix(".json").write_text(json.dumps(list(names), indent=0))
    part.unlink()


def crop(photo: Path, *, side: tuple[int, int], seed: int) -> Pixels:
    """Some of a photo, squeezed to a height and width: where, and how much of it, is drawn."""
    rng, image = np.random.default_rng(seed), open_rgb(photo)
    wide, high = (np.array(image.size) * rng.uniform(*SIDES, size=2)).astype(int)
    left, top = (rng.uniform(size=2) * (np.array(image.size) - (wide, high))).astype(int)
    return squeeze(image.crop((left, top, left + wide, top + high)), *side)


def evenly(many: int, few: int) -> list[int]:
    """So few of many numbers from 0, evenly spread; all of them where there are no more."""
    numbers: list[int] = np.linspace(0, many - 1, min(few, many)).astype(int).tolist()
    return numbers


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="salad-lite")
    parser.add_argument(
        "--photos", type=int, help="training photos, evenly spread over all sets; all of them by default"
    )
    parser.add_argument("--crops", type=int, default=3000)
    parser.add_argument("--sets", nargs="*", default=[each.name for each in SETS], help="of evaluation; all by default")
    parser.add_argument("--train", type=Path, default=TRAIN)
    parser.add_argument("--eval", type=Path, default=EVAL)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    model = load(given.model)
    to = model.preprocessing
    train = sorted(str(path.relative_to(given.train)) for path in find_photos([given.train]))
    # Crops of photos spread evenly over all sets; a photo's number is its seed.
    cropped = {train[at]: at for at in evenly(len(train), given.crops)}
    if given.photos is not None:
        train = [train[at] for at in evenly(len(train), given.photos)]

    def whole(below: Path) -> Callable[[str], Pixels]:
        return lambda name: decode(below / name, to.height, to.width, to.resample)

    def cut(name: str) -> Pixels:
        return crop(given.train / name, side=(to.height, to.width), seed=SEED + cropped[name])

    jobs: list[tuple[str, list[str], Callable[[str], Pixels]]] = [("train", train, whole(given.train))]
    for each in SETS:
        if each.name not in given.sets or not (given.eval / each.name).is_dir():
            continue
        benchmark = each.read(given.eval)
        for side, photos in (("references", benchmark.references), ("queries", benchmark.queries)):
            names = [str(photo.path.relative_to(given.eval)) for photo in photos]
            jobs.append((f"{each.name}-{side}", names, whole(given.eval)))
    jobs.append(("crops", list(cropped), cut))
    for name, names, pixels in jobs:
        if not (given.folder / f"{name}.json").is_file():
            describe(model, names, pixels, given.folder / name)


if __name__ == "__main__":
    main()
