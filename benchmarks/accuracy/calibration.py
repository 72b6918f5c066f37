"""Fit a model's calibration on places held out of its training, and measure it on the evaluation photos.

    python -m benchmarks.accuracy.calibration [--model salad-lite] [--plain] [--write DIR] [--svg docs/reliability.svg]

Fitted on the training photos alone. The index: street photos of one city, all of the places that were trained on
and the older ones of the places held out. The queries: the newest photos of the places held out, once as they are
and once with their place taken out of the index; and photos of the other sets' held-out places, which are nowhere
near. All are asked of large indexes and small ones, with many photos of a place and with one. Whatever is printed of
these is out of fold, by place. Then, never fitted on: `sfxl-30`, and Gardens Point against its index. `--write` puts
the calibration into a model's folder.
"""

from __future__ import annotations

import datetime
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

import salad
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import DATA, benchmark_parser
from salad.datasets.places import find_places
from salad.datasets.training_place import TrainingPlace
from salad.geo import GeoPoint, metres
from salad.images.photo import Photo, read_photo
from salad.index.index import Match
from salad.localize.calibration import BINS, Case, Predictions, calibrate, calibration_error, judge, reliability
from salad.models.describer import Describer
from salad.models.model_folder import write_calibration
from salad.network.config import Calibration
from salad.search.base import ArrayRows, Searcher
from salad.search.exact import ExactSearcher
from salad.search.hubness import Centred, mean_of_all
from salad.training.recipe import PRESETS, preset

SEED, K, NEWEST, STRANGERS = 0, 5, 4, 10  # newest: queries of a place; strangers: photos of a place elsewhere
APART_M = 25.0  # a place's photos in the index are taken out with whatever stands this close to the query
PRECISION = 0.95
# What the models that ship learnt from. Sets that joined the folder later would give other strangers: another fit.
LEARNT_FROM = ("amos-15", "grief-10", "sfxl-240", "vcl-10")
MIXTURE = {"with an answer": 0.8, "own place taken out": 0.1, "strangers": 0.1}
"""What is asked: four in five photos can be found, the others are of streets or of cities not in the index."""
Rows = npt.NDArray[np.float32]


class Shown(NamedTuple):
    """Photos with their descriptors, `[photos, dim]`."""

    photos: list[Photo]
    rows: Rows


@dataclass(frozen=True)
class Question:
    """Queries beside an index; `names` are the places they show, the index's first `own` photos theirs.

    Scores are those of `salad.search.hubness` where `centred`.
    """

    queries: Shown
    names: list[str]
    index: Shown
    own: int = 0
    centred: bool = True

    def smaller(self) -> Question:
        """The same queries beside their own places' photos alone."""
        return self._beside(np.arange(self.own))

    def sparser(self) -> Question:
        """The same queries beside an index of which no two photos stand as close as those of a place do."""
        lat, lon = degrees(self.index)
        left = np.random.default_rng(SEED).permutation(len(lat))
        kept = []
        while len(left):
            kept.append(left[0])
            left = left[metres(lat[left], lon[left], lat[left[0]], lon[left[0]]) > APART_M]
        return self._beside(np.sort(kept))

    def _beside(self, rows: npt.NDArray[np.int64]) -> Question:
        index = Shown([self.index.photos[row] for row in rows], self.index.rows[rows])
        return replace(self, index=index, own=int((rows < self.own).sum()))

    def cases(self, *, taken_out: bool = False, near: bool = True) -> list[Case]:
        """What the index says of each query; with its own place taken out of it, or not near at all, if asked."""
        rows = ArrayRows(self.index.rows)
        searcher: Searcher = ExactSearcher(rows)
        if self.centred:
            searcher = Centred(searcher, mean_of_all(rows))
        lat, lon = degrees(self.index)
        found = []
        for row, (query, name) in enumerate(zip(self.queries.photos, self.names, strict=True)):
            apart = None
            if taken_out and query.where:
                apart = metres(lat, lon, query.where.lat, query.where.lon) > APART_M
            hits = searcher.search(self.queries.rows[row : row + 1], k=K, allowed=apart)
            best = zip(hits.rows[0].tolist(), hits.scores[0].tolist(), strict=True)
            matches = [Match(self.index.photos[n], score, n) for n, score in best if n >= 0]
            found.append(Case(name, matches, query.where if near else None))
        return found


def degrees(shown: Shown) -> npt.NDArray[np.float64]:
    """Latitudes and longitudes, `[2, photos]`."""
    return np.array([(photo.where.lat, photo.where.lon) for photo in shown.photos if photo.where]).T


def gsv(path: Path) -> Photo:
    """A photo with the position in its GSV-Cities name."""
    lat, lon = path.stem.split("_")[5:7]
    return Photo(path, GeoPoint(float(lat), float(lon)))


def described(model: Describer, photos: Sequence[Photo], what: str) -> Shown:
    """Photos with their descriptors."""
    print(f"describing {len(photos)} photos: {what}", file=sys.stderr, flush=True)
    return Shown(list(photos), model.describe([photo.path for photo in photos], batch_size=32))


def held_out(model: Describer, data: Path, city: str, *, centred: bool) -> tuple[Question, Question]:
    """The queries of the city's held-out places beside its index, and strangers beside the same index."""
    name = model.name if model.name in PRESETS else "salad-lite"
    recipe = preset(name).recipe
    places = [place for place in find_places(data) if place.city.startswith(LEARNT_FROM)]
    learnt, apart = recipe.split(places)
    here = [place for place in apart if place.city.startswith(city)]
    known = [path for place in here for path in place.photos[:-NEWEST]]
    others = [path for place in learnt if place.city.startswith(city) for path in place.photos]
    index = described(model, [gsv(path) for path in known + others], f"{city}, the index")
    asked = [(place.name, gsv(path)) for place in here for path in place.photos[-NEWEST:]]
    far = [(name, Photo(path)) for name, path in strangers(apart, city)]
    queries = described(model, [photo for _, photo in asked], f"{city}, queries of {len(here)} places held out")
    strange = described(model, [photo for _, photo in far], "queries of other sets, held out too")
    return (
        Question(queries, [n for n, _ in asked], index, own=len(known), centred=centred),
        Question(strange, [n for n, _ in far], index, own=len(known), centred=centred),
    )


def strangers(apart: Sequence[TrainingPlace], city: str) -> list[tuple[str, Path]]:
    """Photos of other sets, spread over each place's own."""
    return [
        (f"{place.city}/{place.name}", place.photos[n])
        for place in apart
        if not place.city.startswith(city)
        for n in np.unique(np.linspace(0, len(place.photos) - 1, STRANGERS).astype(int))
    ]


def evaluated(model: Describer, data: Path, *, centred: bool) -> tuple[Question, Question]:
    """Queries of `sfxl-30` beside its index, and Gardens Point beside the same."""
    test = data / "sfxl-30" / "images" / "test"
    index, queries = (
        described(model, [read_photo(path) for path in sorted((test / side).glob("*.jpg"))], f"sfxl-30, {side}")
        for side in ("database", "queries")
    )
    paths = sorted((data / "gardens-point" / "day_right").glob("*.jpg"))
    gardens = described(model, [Photo(path) for path in paths], "Gardens Point")
    return (
        Question(queries, [""] * len(queries.photos), index, centred=centred),
        Question(gardens, [""] * len(paths), index, centred=centred),
    )


def say(what: str, judged: Predictions, limit: float) -> None:
    """One line: how well confidence foretells what is right, and what is answered at the limit."""
    answered = judged.confidence >= limit
    weight = np.where(answered, judged.weight, 0)
    right, inside = (
        np.average(good, weights=weight) if answered.any() else np.nan
        for good in (judged.right, judged.error_m <= judged.radius_m)
    )
    print(
        f"{what:29} {len(answered):4} queries | calibration error {calibration_error(judged):.3f} | answered "
        f"{100 * weight.sum() / judged.weight.sum():5.1f} % | right of these {100 * right:5.1f} % | inside the "
        f"radius {100 * inside:5.1f} %"
    )


def table(judged: Predictions) -> None:
    """Print the reliability, step by step; cases count by their weight."""
    print("confidence    cases   mean   right")
    for number, one in enumerate(reliability(judged)):
        told = f"{one.cases:5}  {one.confidence:.3f}  {one.right:.3f}" if one else "    0"
        print(f"{number / BINS:.1f} to {(number + 1) / BINS:.1f}    {told}")


def fitting(here: Question, far: Question) -> dict[str, list[Case]]:
    """The cases a calibration is fitted on, each kind with the weight that `MIXTURE` gives it.

    Every query is asked of a large index and of a small one, of dense ones and of sparse ones, since users have all.
    """
    pairs = [(here, far), (here.sparser(), far.sparser())]
    pairs += [(near.smaller(), strange.smaller()) for near, strange in pairs]
    kinds = {
        "with an answer": [case for near, _ in pairs for case in near.cases()],
        "own place taken out": [case for near, _ in pairs for case in near.cases(taken_out=True)],
        "strangers": [case for _, strange in pairs for case in strange.cases(near=False)],
    }
    whole = sum(map(len, kinds.values()))
    return {
        kind: [replace(case, weight=MIXTURE[kind] * whole / len(cases)) for case in cases]
        for kind, cases in kinds.items()
    }


def provenance(model: Describer, here: Question, far: Question, city: str) -> str:
    """What the numbers were fitted on."""
    return (
        f"benchmarks/accuracy/calibration.py, {datetime.date.today()}, model {model.fingerprint}: {len(here.names)} "
        f"queries of {len(set(here.names))} places held out of {city}, beside {len(here.index.photos)} and "
        f"{here.own} photos and one of each place, with and without their place, and {len(far.names)} photos of "
        "elsewhere"
    )


def measured(model: Describer, data: Path, calibration: Calibration) -> Predictions:
    """Print what a calibration is worth on the evaluation photos; what it says of `sfxl-30`."""
    street, gardens = evaluated(model, data, centred=calibration.centred)
    limit, seen = calibration.min_confidence, judge(street.cases(), calibration)
    say("sfxl-30", seen, limit)
    say("sfxl-30, own place taken out", judge(street.cases(taken_out=True), calibration), limit)
    sparse = street.sparser()
    say("sfxl-30, a photo a place", judge(sparse.cases(), calibration), limit)
    say("  own place taken out", judge(sparse.cases(taken_out=True), calibration), limit)
    say("Gardens Point beside sfxl-30", judge(gardens.cases(near=False), calibration), limit)
    return seen


def diagram(series: Sequence[tuple[str, str, Predictions]], to: Path) -> None:
    """Draw confidence against the share of right ones, a disc a step, its area the number of cases."""
    side, edge = 360, 56
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {side + 2 * edge} {side + 2 * edge}" '
        'font-family="sans-serif" font-size="13" fill="#334">',
        f'<rect width="{side + 2 * edge}" height="{side + 2 * edge}" fill="#fff"/>',
        f'<rect x="{edge}" y="{edge}" width="{side}" height="{side}" fill="none" stroke="#99a"/>',
        f'<path d="M{edge} {edge + side}L{edge + side} {edge}" stroke="#99a" stroke-dasharray="4 4"/>',
        f'<text x="{edge + side / 2}" y="{2 * edge + side - 14}" text-anchor="middle">confidence</text>',
        f'<text transform="translate(16 {edge + side / 2}) rotate(-90)" text-anchor="middle">share right</text>',
    ]
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = edge + tick * side, edge + side - tick * side
        parts.append(f'<text x="{x}" y="{edge + side + 18}" text-anchor="middle">{tick:g}</text>')
        parts.append(f'<text x="{edge - 8}" y="{y + 4}" text-anchor="end">{tick:g}</text>')
    for number, (name, colour, judged) in enumerate(series):
        parts.append(f'<text x="{edge + 14}" y="{edge - 30 + 18 * number}" fill="{colour}">● {name}</text>')
        for one in filter(None, reliability(judged)):
            x, y = edge + one.confidence * side, edge + side - one.right * side
            size = 2 + 40 * one.weight**0.5
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="{colour}" fill-opacity="0.55">'
                f"<title>{name}: {one.cases} cases, {one.confidence:.2f} sure, {one.right:.2f} right</title></circle>"
            )
    to.write_text("\n".join([*parts, "</svg>", ""]), encoding="utf-8")


def main() -> None:
    """Fit, measure, print; write what is asked for."""
    parser = benchmark_parser(__doc__, data=DATA)
    parser.add_argument("--model", default="salad-lite", help="whatever `salad.load` takes")
    parser.add_argument("--plain", action="store_true", help="scores of descriptors as they are, not centred")
    parser.add_argument("--city", default="sfxl-240", help="a training set in GSV-Cities' layout")
    parser.add_argument("--write", type=Path, metavar="DIR", help="a model's folder to put the calibration into")
    parser.add_argument("--svg", type=Path, metavar="FILE", help="draw the reliability diagram")
    asked = parser.parse_args()
    model = salad.load(asked.model)
    here, far = held_out(model, asked.data / "train", asked.city, centred=not asked.plain)
    print(in_a_line(conditions(seed=SEED, k=K, model=f"{model.name} {model.fingerprint}")))
    kinds = fitting(here, far)
    cases = [case for some in kinds.values() for case in some]
    told = provenance(model, here, far, asked.city)
    calibration, judged = calibrate(cases, precision=PRECISION, seed=SEED, provenance=told)
    calibration = replace(calibration, centred=here.centred)
    print("\n".join(f"  {name:15} {value}" for name, value in calibration.as_dict().items()))
    table(judged)
    say("out of fold", judged, calibration.min_confidence)
    first = 0
    for kind, some in kinds.items():
        part = Predictions(*(values[first : first + len(some)] for values in judged))
        say(f"  {kind}", part, calibration.min_confidence)
        first += len(some)
    if asked.write:
        write_calibration(asked.write, calibration)
    drawn = [("out of fold, places held out", "#2a6fbb", judged)]
    if (asked.data / "eval").is_dir():
        drawn.append(("sfxl-30", "#d4722a", measured(model, asked.data / "eval", calibration)))
    if asked.svg:
        diagram(drawn, asked.svg)


if __name__ == "__main__":
    main()
