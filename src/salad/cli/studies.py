"""The commands about models: `salad evaluate`, `train` and `demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from salad.cli import shell
from salad.cli.arguments import SHIPPED, File, Form, Metres, Number, Share, Table
from salad.errors import BenchmarkError

if TYPE_CHECKING:
    from salad.data.benchmark import Benchmark


@dataclass(frozen=True)
class Evaluate:
    """Measure a model: how often is one of the first k matches right?

    Name the rule by exactly one of --truth, --frames and --radius.
    """

    references: Path
    """Folder of photos whose places are known."""
    queries: Path
    """Folder of photos to recognise."""
    truth: Table = None
    """A CSV query,positives: names within the two folders, positives separated by semicolons."""
    frames: Number = None
    """Right within so many frames; a photo's frame is the last whole number in its name."""
    radius: Metres = None
    """Right within so many metres, by geotag."""
    model: Annotated[str, arg(metavar="NAME|DIR|FILE")] = SHIPPED
    """A name of the zoo, a folder or a published file."""
    heads: Number = None
    """Attention heads of a published file that are not width / 64."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    format: Form = "table"

    def run(self) -> int:
        """Evaluate."""
        from salad.evaluation import evaluate
        from salad.model.weights import load

        benchmark = self._benchmark()
        model = load(self.model, device=self.device, heads=self.heads)
        with shell.progress("describing") as bar:
            result = evaluate(benchmark, model, progress=bar)
        for note in result.notes:
            shell.say(note)
        told = result.as_dict()
        if self.format == "json":
            shell.put_json(told)
        else:
            recall, seconds = told.pop("recall"), told.pop("seconds")
            percent = {f"R@{k}": f"{value:.1f} %" for k, value in recall.items()}
            shell.facts(told | {"seconds": f"{seconds:.1f}"} | percent)
        return shell.FOUND

    def _benchmark(self) -> Benchmark:
        from salad.data import benchmark

        rules = [rule for rule in (self.truth, self.frames, self.radius) if rule is not None]
        if len(rules) != 1:
            raise BenchmarkError(
                f"{len(rules)} rules say what is right, but it takes one: --truth, --frames or --radius"
            )
        if self.truth is not None:
            return benchmark.from_truth(self.references, self.queries, self.truth)
        if self.frames is not None:
            return benchmark.from_frames(self.references, self.queries, self.frames)
        assert self.radius is not None
        return benchmark.from_radius(self.references, self.queries, self.radius)


@dataclass(frozen=True)
class Train:
    """Train a model and write it to TO/model; a run that was interrupted goes on where it stopped."""

    data: Path
    """GSV-Cities, a folder of folders (one a place), or a folder of such sets."""
    to: Path
    """The run's folder."""
    preset: str = SHIPPED
    """What to train: salad-lite, or salad-vits with --start."""
    start: File = None
    """Other weights for the backbone to start from: a file with its names."""
    head_steps: Number = None
    """Steps with the backbone frozen, where not the preset's."""
    tune_steps: Number = None
    """Steps with all of it trained, where not the preset's."""
    held_out: Share = None
    """Share of the places to choose by, where not the preset's."""
    seed: Number = None
    """Of everything random, where not the preset's."""
    accelerator: str = "auto"
    """auto, cpu, gpu or mps."""

    def run(self) -> int:
        """Train."""
        from dataclasses import replace

        from salad.data.places import find_places
        from salad.train.loop import train
        from salad.train.recipe import preset

        chosen = preset(self.preset)
        given = {name: getattr(self, name) for name in ("head_steps", "tune_steps", "held_out", "seed")}
        recipe = replace(chosen.recipe, **{name: value for name, value in given.items() if value is not None})
        made = train(
            replace(chosen, recipe=recipe),
            find_places(self.data),
            to=self.to,
            start=self.start,
            accelerator=self.accelerator,
            say=shell.say,
        )
        shell.put(str(made))
        return shell.FOUND


@dataclass(frozen=True)
class Demo:
    """Draw a town, index its photos, locate others, and show it all on one page."""

    to: Path = Path("demo")
    """The folder for photos, index and page."""
    seed: int = 7
    """Decides the town."""

    def run(self) -> int:
        """Show what this is about."""
        from salad.demo import run_demo
        from salad.demo.report import table

        with shell.progress("demo") as bar:
            result = run_demo(self.to, seed=self.seed, say=shell.say, progress=bar)
        shell.put_table(table(result))
        shell.put(f"look at it: {result.page.resolve()}")
        return shell.FOUND
