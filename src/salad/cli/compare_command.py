"""`salad compare`: two results of `salad evaluate`, or the models of one of the paper's tables on equal terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from salad.ablation.grids import Grid
from salad.cli import terminal
from salad.cli.arguments import Format, Number, positive
from salad.errors import BenchmarkError, needs_extra

if TYPE_CHECKING:
    from salad.ablation.grids import GridRow
    from salad.ablation.runner import GridBenchmark
    from salad.datasets.benchmark import Benchmark
    from salad.models.describer import Describer


RULES = "frames:N, radius:METRES or truth:FILE"
Results = Annotated[
    Positional[tuple[Path, ...]],
    arg(
        metavar="RESULT.json",
        help="Two results, as `salad evaluate --save` writes them; the second is held against the first.",
        help_behavior_hint="",
    ),
]
Sets = Annotated[
    UseAppendAction[tuple[tuple[str, Path, Path, str], ...]],
    arg(metavar="NAME REFERENCES QUERIES RULE", help_behavior_hint="(repeatable)"),
]


@dataclass(frozen=True)
class CompareCommand:
    """Say whether two results differ by more than chance; or, with --grid, train models and compare those.

    Two files that `salad evaluate --save` wrote are compared query by query. With --grid, every row of one of the
    paper's tables is trained with every seed, on equal terms, and measured on every benchmark; our figures stand
    beside the paper's. A run that was interrupted goes on, a finished one is never repeated. Writes TO/GRID.md, .csv
    and .svg.
    """

    files: Results = ()
    grid: Annotated[Grid | None, arg(metavar="GRID", help_behavior_hint="")] = None
    """What is trained and compared: aggregators, (trained) blocks, parts of SALAD, or sizes of it."""
    to: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """With --grid, the folder of all runs and of the tables."""
    data: Annotated[tuple[Path, ...], arg(help_behavior_hint="")] = ()
    """Folders to learn from, as `salad train` takes them."""
    benchmark: Sets = ()
    """A set to measure on, its two folders, and what is right: frames:N, radius:METRES or truth:FILE."""
    rows: Annotated[tuple[str, ...], arg(help_behavior_hint="")] = ()
    """Rows of the grid by name, where not all."""
    seeds: int = 3
    """How many times each row is trained: with seeds 0, 1, 2 ..."""
    steps: Number = None
    """Training steps of every run, where not those of the small preset (with --frozen, of the head preset)."""
    size: int = 224
    """Side in pixels of the squares that photos are squeezed to."""
    start: str = "imagenet"
    """Where the backbone starts: imagenet for EfficientNet-Lite0, or a file of a DINOv2 backbone."""
    depth: Number = None
    """Blocks kept of a file's backbone, where not all."""
    frozen: bool = False
    """Train no block in any row: heads learn from tokens kept on disk, far more steps in the same time."""
    accelerator: str = "auto"
    """Where to train: auto, cpu, gpu or mps."""
    device: str = "cpu"
    """Where to measure, as torch names it."""
    table_only: bool = False
    """Write the tables from the results there are, and train nothing."""
    format: Format = "table"

    def run(self) -> int:
        """Compare."""
        if self.files:
            return self._compare_results()
        if self.grid is None or self.to is None:
            raise BenchmarkError(
                "nothing says what to compare: give two results of `salad evaluate --save`, or --grid and --to"
            )
        return self._compare_models(self.grid, self.to)

    def _compare_results(self) -> int:
        from salad.cli.evaluation_tables import compare_results

        if self.grid is not None:
            raise BenchmarkError(
                f"results are compared as they are, and --grid {self.grid} trains models: give one or the other"
            )
        if len(self.files) != 2:
            raise BenchmarkError(f"two results are compared, but {len(self.files)} files are given: give two")
        return compare_results(*self.files, form=self.format)

    def _compare_models(self, grid: Grid, to: Path) -> int:
        from salad.ablation.comparison_tables import write_tables
        from salad.ablation.grids import grid_rows

        rows = grid_rows(grid, self.rows)
        if grid == "blocks" and self.frozen:
            raise BenchmarkError("--grid blocks compares how many blocks are trained: leave --frozen out")
        if not self.table_only:
            self._train(rows, to)
        terminal.write(write_tables(to, grid, rows))
        missing = [row.name for row in rows if not any((to / row.name).glob("seed*/result.json"))]
        if missing:
            terminal.say(f"there is no result yet of {', '.join(missing)}")
        terminal.say(f"written to {to / grid}.md, .csv and .svg")
        return terminal.FOUND

    def _train(self, rows: Sequence[GridRow], to: Path) -> None:
        """Bring every row to its results; what is wrong with the arguments is said before torch is loaded."""
        positive(self.seeds, "seeds")
        positive(self.size, "size")
        benchmarks = self._benchmarks()
        from salad.datasets.places import find_places

        if not self.data:
            raise BenchmarkError("there is nothing to learn from: name a folder with --data")
        places = [place for folder in self.data for place in find_places(folder, say=terminal.say)]

        with needs_extra("training the models to compare", "train"):
            from salad.ablation.grid_setup import default_recipe, grid_setup
            from salad.ablation.runner import GridRunner

        recipe = default_recipe(self.start, frozen=self.frozen)
        if self.steps is not None:
            recipe = recipe.of_steps(positive(self.steps, "steps"))
        GridRunner(
            places=places,
            to=to,
            setup=grid_setup(self.start, side=self.size, recipe=recipe, depth=self.depth),
            benchmarks={each.name: _grid_benchmark(each) for each in benchmarks},
            accelerator=self.accelerator,
            device=self.device,
            say=terminal.say,
            progress_bar=terminal.progress,
        ).run(rows, seeds=range(self.seeds))

    def _benchmarks(self) -> list[Benchmark]:
        if not self.benchmark:
            raise BenchmarkError(
                "there is nothing to measure on: give --benchmark NAME REFERENCES QUERIES RULE, the rule "
                f"{RULES}; once for each set"
            )
        names = [name for name, *_ in self.benchmark]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise BenchmarkError(f"two benchmarks are called {twice[0]!r}: give each a name of its own")
        return [benchmark_by_rule(*each) for each in self.benchmark]


def benchmark_by_rule(name: str, references: Path, queries: Path, rule: str) -> Benchmark:
    """A set by its two folders and the rule `frames:N`, `radius:METRES` or `truth:FILE`.

    Raises:
        BenchmarkError: If the rule is none of these, or the set cannot be read.
        PhotoError: If a folder is missing or holds no photo.
    """
    from salad.datasets import benchmark as sets

    kind, _, value = rule.partition(":")
    try:
        if kind == "frames":
            return sets.from_frames(references, queries, int(value), name=name)
        if kind == "radius":
            return sets.from_radius(references, queries, float(value), name=name)
    except ValueError:  # not a number: refused below, as what is no rule at all
        value = ""
    if kind == "truth" and value:
        return sets.from_truth(references, queries, Path(value), name=name)
    raise BenchmarkError(f"benchmark {name!r}: what is right is not said by {rule!r}: give {RULES}")


def _grid_benchmark(benchmark: Benchmark) -> GridBenchmark:
    """How a model is measured on a set: as `salad evaluate` does it."""
    from salad.ablation.runner import GridBenchmark
    from salad.evaluation.evaluate_benchmark import evaluate

    def evaluated(model: Describer) -> dict[str, object]:
        with terminal.progress(f"describing {benchmark.name}") as bar:
            return evaluate(benchmark, model, progress=bar).as_dict()

    return GridBenchmark(benchmark.protocol, evaluated)
