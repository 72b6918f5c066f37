"""What a model reaches as its dustbin takes less or more of the tokens, nothing learnt anew.

    python -m benchmarks.accuracy.dustbin_share [MODEL ...] [--shares 0.1 0.35 0.68] [--data ../shared/data]

Precision on the places held out of the training, then R@1 on the evaluation sets of some hundred photos, plain / with
scores centred. It shows what the dustbin is good for; a model that ships has the share it was trained with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.accuracy.held_out import told
from benchmarks.accuracy.recall import SETS
from benchmarks.options import DATA, benchmark_parser
from salad.datasets.places import find_places
from salad.evaluation.evaluate_benchmark import evaluate
from salad.models.describer import Describer
from salad.models.model_folder import load
from salad.network.aggregator_config import SaladConfig
from salad.network.config import Calibration
from salad.network.network import load_weights
from salad.training.batches import ImageCache
from salad.training.recipe import PRESETS
from salad.training.validation import precision_held_out

SHARES = (0.1, 0.2, 0.35, 0.5, 0.68, 0.8)
SMALL = [each for each in SETS if each.name not in ("toy", "nordland64")]


def with_share(model: Describer, share: float) -> Describer:
    """The same weights under a dustbin that takes so much."""
    aggregator = model.config.aggregator
    if not isinstance(aggregator, SaladConfig) or not aggregator.dustbin:
        raise SystemExit(f"{model.name} has no dustbin of its own: give a SALAD model")
    config = replace(
        model.config,
        aggregator=replace(aggregator, dustbin_share=share),
        calibration=Calibration(centred=True),
    )
    return Describer.of(load_weights(config, model.weights(), source=Path(model.name)))


def recalls(model: Describer, data: Path) -> Iterator[str]:
    """R@1 on each set that is there: plain / centred."""
    for each in SMALL:
        if (data / each.name).is_dir():
            read = each.read(data)
            with TemporaryDirectory() as cache:
                plain, centred = (
                    evaluate(read, model, ks=(1,), plain=plain, cache=Path(cache)).recall[1] for plain in (True, False)
                )
            yield f"{each.name} {plain:.1f} / {centred:.1f}"


def main() -> None:
    parser = benchmark_parser(__doc__, data=DATA, models=["salad-lite"])
    parser.add_argument("--shares", nargs="+", type=float, default=list(SHARES), metavar="SHARE")
    asked = parser.parse_args()
    recipe = PRESETS["salad-lite"].recipe
    _, held_out = recipe.split(find_places(asked.data / "train"))
    for name in asked.models:
        model = load(name)
        with ImageCache(model.preprocessing) as shelf:
            for share in asked.shares:
                made = with_share(model, share)
                figures = told(precision_held_out(made, held_out, shelf))
                print(
                    f"{name} {share}: {figures} | " + "  ".join(recalls(made, asked.data / "eval")),
                    flush=True,
                )


if __name__ == "__main__":
    main()
