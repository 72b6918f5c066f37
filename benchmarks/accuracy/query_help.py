"""What help for a query is worth: describing it twice, or leaving out of its scores what all photos of the index share.

    python -m benchmarks.accuracy.query_help [--model salad-lite]

On the photos that `calibration.py` fits on, places held out of training; never on evaluation photos. Each way gets
a calibration of its own, so that it is compared at its best; what is printed of it is out of fold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image, ImageOps

import salad
from benchmarks.accuracy.calibration import APART_M, SEED, Question, Shown, fitting, held_out
from benchmarks.accuracy.centring import unit
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import DATA, benchmark_parser
from salad.geo import metres
from salad.images.decode import open_rgb
from salad.localize.calibration import Case, calibrate, log_loss
from salad.models.describer import Describer

Change = Callable[[Image.Image], Image.Image]


def mirrored(image: Image.Image) -> Image.Image:
    """The photo as in a mirror."""
    return ImageOps.mirror(image)


def cropped(image: Image.Image) -> Image.Image:
    """The photo without a tenth of it on every side."""
    w, h = image.size
    return image.crop((w // 10, h // 10, w - w // 10, h - h // 10))


def query_help(model: Describer, here: Question, far: Question) -> None:
    """Print what each help does out of fold for the held-out queries, strangers and all."""

    def again(shown: Shown, change: Change) -> Shown:
        size = (model.preprocessing.height, model.preprocessing.width)
        photos = (open_rgb(photo.path, at_least=size) for photo in shown.photos)  # decoded as for the model
        other = model.describe([change(photo) for photo in photos], batch_size=32)
        return Shown(shown.photos, unit(shown.rows + other))

    ways = {
        "nothing": (here.queries, far.queries, False),
        "mean with the mirrored query": (again(here.queries, mirrored), again(far.queries, mirrored), False),
        "mean with the cropped query": (again(here.queries, cropped), again(far.queries, cropped), False),
        "scores centred": (here.queries, far.queries, True),
    }
    print("query help                      first match right | log loss | answered at 95 % precision")
    for name, (queries, others, centred) in ways.items():
        asked = replace(here, queries=queries, centred=centred)
        strange = replace(far, queries=others, centred=centred)
        cases = [case for some in fitting(asked, strange).values() for case in some]
        fitted, judged = calibrate(cases, seed=SEED)
        right = np.mean([metres_off(case) <= APART_M for case in asked.cases()])
        answered = np.average(judged.confidence >= fitted.min_confidence, weights=judged.weight)
        print(f"{name:31} {100 * right:15.1f} % | {log_loss(judged):8.4f} | {100 * answered:6.1f} %")


def metres_off(case: Case) -> float:
    """How far the best match is from the truth."""
    best = case.matches[0].photo.where
    assert best is not None
    assert case.truth is not None
    return float(metres(best.lat, best.lon, case.truth.lat, case.truth.lon))


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__, data=DATA)
    parser.add_argument("--model", default="salad-lite", help="whatever `salad.load` takes")
    parser.add_argument("--city", default="sfxl-240", help="a training set in GSV-Cities' layout")
    asked = parser.parse_args()
    model = salad.load(asked.model)
    here, far = held_out(model, asked.data / "train", asked.city, centred=False)
    print(in_a_line(conditions(seed=SEED, model=f"{model.name} {model.fingerprint}")))
    query_help(model, here, far)


if __name__ == "__main__":
    main()
