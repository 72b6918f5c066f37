"""Whether storing descriptors as float16 changes the first answer on any evaluation set beside the checkout.

    python -m benchmarks.accuracy.float16 [MODEL ...] [--data ../shared/data/eval]

Queries stay in float32, as in a search; references are compared once as the model gives them and once as the
index stores them, both scored in float64. A tie is a changed answer between references whose float32 scores lie
within float32's own rounding of one another: there no storage could tell which is first.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from benchmarks.accuracy.recall import SETS, describer
from benchmarks.machine import conditions, in_a_line
from benchmarks.options import EVAL, benchmark_parser
from salad.images.photo import Photo
from salad.index.vectors import storable
from salad.models.describer import DescriberLike

BATCH = 16
ROUNDING = 2.0**-22  # of a float32 score around 1, sums of thousands of products included

Floats = npt.NDArray[np.float32]


def described(model: DescriberLike, photos: Sequence[Photo]) -> Floats:
    """Descriptors `[N, dim]`."""
    paths = [photo.path for photo in photos]
    parts = [model.describe(paths[low : low + BATCH]) for low in range(0, len(paths), BATCH)]
    return np.concatenate(parts)


def compared(queries: Floats, references: Floats) -> tuple[int, int, float]:
    """Queries whose first answer changes, those of them that are ties, and the largest change of a score."""
    exact = references.astype(np.float64)
    stored = storable(references, *references.shape).astype(np.float64)
    changed = ties = 0
    most = 0.0
    for query in queries.astype(np.float64):
        before, after = ((rows * query).sum(axis=1) for rows in (exact, stored))
        first, now = int(before.argmax()), int(after.argmax())
        changed += first != now
        ties += first != now and before[first] - before[now] <= ROUNDING
        most = max(most, float(np.abs(after - before).max()))
    return changed, ties, most


def main() -> None:
    parser = benchmark_parser(__doc__, data=EVAL, models=["salad-lite"])
    asked = parser.parse_args()
    print(in_a_line(conditions("numpy", seed=None)))
    print("| model | dim | set | queries | references | first answer changed | of these ties | largest change |")
    print("|---|---|---|---|---|---|---|---|")
    for name in asked.models:
        model = describer(name)
        for each in SETS:
            if not (asked.data / each.name).is_dir():
                print(f"{each.name}: not at {asked.data}, passed over", file=sys.stderr)
                continue
            benchmark = each.read(asked.data)
            queries, references = (described(model, p) for p in (benchmark.queries, benchmark.references))
            changed, ties, most = compared(queries, references)
            print(
                f"| {name} | {model.dim} | {each.name} | {len(queries)} | {len(references)} | {changed} | "
                f"{ties} | {most:.1e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
