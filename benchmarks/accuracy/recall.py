"""Recall of several models on the evaluation photos beside the checkout, each figure with its protocol.

    python -m benchmarks.accuracy.recall [MODEL ...] [--plain] [--data ../shared/data/eval] [--json figures.jsonl]

A MODEL is a key of `DESCRIBERS`, or whatever `salad.load` takes: a name of the zoo, a folder, a file. The
photos are not part of the repository; a set that is not there is passed over with a sentence.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.accuracy.baselines import Hog, UntrainedGrid, untrained
from benchmarks.machine import conditions
from benchmarks.options import EVAL, SHIPPED, benchmark_parser
from salad.cli.compare_command import benchmark_by_rule
from salad.datasets.benchmark import Benchmark
from salad.errors import SaladError
from salad.evaluation.evaluate_benchmark import evaluate
from salad.evaluation.result import Result
from salad.models.model_folder import load

SEED = 0  # nothing here is drawn at random but the unused head of the untrained model
KS = (1, 5, 10, 20)


@dataclass(frozen=True)
class Set:
    """One evaluation set: whether its viewpoint changes, its two folders, and the rule that says what is right."""

    name: str
    viewpoint: str
    references: str
    queries: str
    rule: str

    def options(self, data: Path) -> tuple[str, Path, Path, str]:
        """What follows `--benchmark`, for a folder of such sets."""
        folder = data / self.name
        kind, _, value = self.rule.partition(":")
        right = f"truth:{folder / value}" if kind == "truth" else self.rule
        return self.name, folder / self.references, folder / self.queries, right

    def read(self, data: Path) -> Benchmark:
        """The set, from a folder of such sets."""
        return benchmark_by_rule(*self.options(data))


# A camera that looks the same way again hides what a descriptor makes of another viewpoint, so the two kinds
# are never averaged. sfxl-30 is of that kind too: years apart, but one direction, and the right first
# answers of HOG stand 1.8 m (median) from their query.
SETS = (
    Set("gardens-point", "changing", "day_left", "day_right", "frames:2"),
    Set("essex", "changing", "database", "queries", "truth:gt.csv"),
    Set("corridor", "changing", "database", "queries", "truth:gt.csv"),
    Set("toy", "changing", "database", "queries", "truth:gt.csv"),
    Set("sfxl-30", "fixed", "images/test/database", "images/test/queries", "radius:25"),
    Set("nordland64", "fixed", "database", "queries", "frames:1"),
)


DESCRIBERS: Mapping[str, Callable[[], Any]] = {  # made only when its turn comes, since each takes memory
    "hog": Hog,
    "salad-lite-untrained": untrained,
    "salad-lite-untrained-average": partial(untrained, "average"),
    "salad-lite-untrained-grid": UntrainedGrid,
    "salad-lite-untrained-vlad": partial(untrained, "vlad"),
    **{name: partial(load, name) for name in SHIPPED},
}


def describer(name: str) -> Any:
    """One of `DESCRIBERS`, or whatever `salad.load` takes."""
    return DESCRIBERS.get(name, partial(load, name))()


Row = tuple[str, Set, Result]  # the name a model was asked for by, and what it reached on a set


def measure(
    models: Sequence[str],
    data: Path,
    *,
    sets: Sequence[Set] = SETS,
    plain: bool = False,
    cache: Path | None = None,
) -> Iterator[Row]:
    """Evaluate every model on every set that is there; each figure comes as soon as it is measured."""
    benchmarks = []
    for each in sets:
        if (data / each.name).is_dir():
            benchmarks.append((each, each.read(data)))
        else:
            print(f"{each.name}: not at {data}, passed over", file=sys.stderr)
    for name in models:
        try:
            model = describer(name)
        except SaladError as error:
            print(f"{name}: passed over, {error}", file=sys.stderr)
            continue
        for each, read in benchmarks:
            print(f"{name} on {each.name} ...", file=sys.stderr)
            result = evaluate(read, model, ks=KS, plain=plain, cache=cache)
            yield name if result.model == model.name else f"{name}, plain", each, result


def table(rows: Sequence[Row]) -> str:
    """Lay out R@1 / R@5 as a Markdown table: a line a model, a column a set."""
    results = {(name, each.name): result for name, each, result in rows}
    models, sets = list(dict.fromkeys(row[0] for row in rows)), list(dict.fromkeys(row[1] for row in rows))
    heads = [f"{each.name}, {results[models[0], each.name].protocol}, {each.viewpoint} viewpoint" for each in sets]
    lines = ["| R@1 / R@5 | " + " | ".join(heads) + " |", "|---" * (len(sets) + 1) + "|"]
    for model in models:
        recalls = [results[model, each.name].recall for each in sets]
        lines.append(f"| {model} | " + " | ".join(f"{r[1]:.1f} / {r[5]:.1f}" for r in recalls) + " |")
    return "\n".join(lines)


def line(row: Row) -> str:
    """Give one figure as a JSON object, with all that is needed to repeat it."""
    name, each, result = row
    figure = {"set": each.name, "viewpoint": each.viewpoint, **result.as_dict(), "model": name}
    return json.dumps({**figure, **conditions(seed=SEED)}, ensure_ascii=False)


def main() -> None:
    parser = benchmark_parser(__doc__, data=EVAL, models=list(DESCRIBERS))
    parser.add_argument("--json", type=Path, help="append the JSON lines here instead of printing them")
    parser.add_argument("--plain", action="store_true", help="descriptors as they are, as papers compare them")
    parser.add_argument("--cache", type=Path, help="keep descriptors here, for the same models again")
    asked = parser.parse_args()
    rows = []
    with asked.json.open("a", encoding="utf-8") if asked.json else nullcontext(sys.stdout) as out:
        for row in measure(asked.models, asked.data, plain=asked.plain, cache=asked.cache):
            rows.append(row)
            print(line(row), file=out, flush=True)  # an hour's figures outlive an interrupt
    if not rows:
        print(f"nothing to measure: no set at {asked.data}, or no model", file=sys.stderr)
        raise SystemExit(1)
    print(table(rows))


if __name__ == "__main__":
    main()
