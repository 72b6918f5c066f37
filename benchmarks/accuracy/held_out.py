"""The figure that the models which ship were chosen by: precision on the places held out of the training photos.

    python -m benchmarks.accuracy.held_out [MODEL ...] [--data ../shared/data/train]

As `salad train` prints it on its way, in float32: the mean over the sets of the mean average precision with which the
newest photos of each place find the others of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.options import SHIPPED, TRAIN, benchmark_parser
from salad.datasets.places import find_places
from salad.datasets.training_place import TrainingPlace
from salad.models.model_folder import load
from salad.training.batches import ImageCache
from salad.training.recipe import PRESETS, Augment, Recipe, Sampling
from salad.training.validation import precision_held_out

MINED_EVERY = 100  # steps, for batches of places that look alike


def told(figures: Mapping[str, float]) -> str:
    """Precision by set, on one line."""
    return "  ".join(f"{city} {figure:.1f}" for city, figure in figures.items())


def leave_out(
    parser: argparse.ArgumentParser, data: Path, sets: Sequence[str]
) -> tuple[list[TrainingPlace], list[TrainingPlace]]:
    """Places of the sets that stay, and of those whose names begin so; an error of usage where either is empty."""
    places, names = find_places(data), tuple(sets)
    known = [place for place in places if not place.city.startswith(names)]
    unknown = [place for place in places if place.city.startswith(names)]
    if not unknown or not known:
        parser.error(f"--leave-out {' '.join(sets)} leaves out all sets, or none")
    return known, unknown


def drawn(recipe: Recipe, augment: Augment, sampler: Sampling) -> Recipe:
    """The same recipe on photos changed and batches drawn in another way."""
    mined = MINED_EVERY if sampler == "cliques" else 0
    return replace(recipe, augment=augment, sampler=sampler, mine_every=mined)


def main() -> None:
    parser = benchmark_parser(__doc__, data=TRAIN, models=SHIPPED)
    asked = parser.parse_args()
    recipe = PRESETS["salad-lite"].recipe
    _, held_out = recipe.split(find_places(asked.data))
    for name in asked.models:
        model = load(name)
        with ImageCache(model.preprocessing) as shelf:
            figures = precision_held_out(model, held_out, shelf)
        print(f"{name} {model.fingerprint}: {told(figures)}", flush=True)


if __name__ == "__main__":
    main()
