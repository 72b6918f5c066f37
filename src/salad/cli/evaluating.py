"""`salad evaluate`: any model, or any other method's descriptors or rankings, judged under a named protocol."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from salad.cli import shell, verdicts
from salad.cli.arguments import SHIPPED, Form, Metres, Number, Table
from salad.cli.judging import benchmark_of
from salad.errors import BenchmarkError

if TYPE_CHECKING:
    from salad.data.benchmark import Benchmark
    from salad.evaluation import Result

Folder = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")]
Text = Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")]
FilePath = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
TwoFiles = Annotated[
    tuple[Path, Path] | None, arg(metavar="REFERENCES.npy QUERIES.npy", help_behavior_hint="")
]

TwoNames = Annotated[
    tuple[Path, Path] | None, arg(metavar="REFERENCES.txt QUERIES.txt", help_behavior_hint="")
]


@dataclass(frozen=True)
class Evaluate:
    """Measure a model: how often is one of the first k matches right, and how sure is that?

    Name the set by --references and --queries with exactly one of --truth, --frames and --radius; or by --protocol
    with --data. `salad datasets` lists the protocols.
    """

    references: Folder = None
    """Folder of photos whose places are known."""
    queries: Folder = None
    """Folder of photos to recognise."""
    truth: Table = None
    """A CSV query,positives: names within the two folders, positives separated by semicolons."""
    frames: Number = None
    """Right within so many frames; a photo's frame is the last whole number in its name."""
    radius: Metres = None
    """Right within so many metres, by geotag."""
    protocol: Text = None
    """A published protocol by its name, which says what is right."""
    data: Folder = None
    """The folder of that protocol's data set."""
    any_size: bool = False
    """Take a set whose counts are not the protocol's; its figures then say so."""
    model: Annotated[str, arg(metavar="NAME|DIR|FILE")] = SHIPPED
    """A name of the zoo, a folder or a published file."""
    heads: Number = None
    """Attention heads of a published file that are not width / 64."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    descriptors: TwoFiles = None
    """Judge these in place of a model: a row a photo, in the order of the set's photos."""
    rankings: FilePath = None
    """Judge these in place of a model: lines `query_key ref_key ref_key ...`, best first."""
    list_photos: TwoNames = None
    """Write the paths of the set's photos to these files, in the order descriptors have to be in; judge nothing."""
    called: Text = None
    """What to call a method that descriptors or rankings come from, where not by their file."""
    cache: Folder = None
    """Keep descriptors here, and describe no photo that is here already; without it none are kept."""
    leaks: bool = False
    """List photos that are references and queries at once."""
    save: FilePath = None
    """Write the whole result as JSON, for `salad compare`."""
    csv: FilePath = None
    """Write a table with one line a query."""
    save_rankings: FilePath = None
    """Write what was found as lines `query_key ref_key ref_key ...`."""
    seed: int = 0
    """Of the draws that tell how sure the figures are."""
    format: Form = "table"

    def run(self) -> int:
        """Evaluate."""
        from salad.evaluation.measuring import with_leaks

        self._check()
        benchmark = self._benchmark()
        if self.list_photos is not None:
            return self._listed(benchmark, *self.list_photos)
        result = self._judged(benchmark)
        if self.leaks:
            result = with_leaks(result, benchmark)
        self._write(result)
        for note in (*result.notes, *verdicts.leaks_told(result)):
            shell.say(note)
        if self.format == "json":
            shell.put_json(result.as_dict())
        else:
            shell.facts(verdicts.facts(result))
            shell.put_table(verdicts.figures(result))
        return shell.FOUND

    def _check(self) -> None:
        """Refuse before any work what would come to nothing after it."""
        if self.descriptors is not None and self.rankings is not None:
            raise BenchmarkError("--descriptors and --rankings are two methods: judge one at a time")
        if self.cache is not None and (self.descriptors is not None or self.rankings is not None):
            raise BenchmarkError("--cache keeps what a model describes, and no model is asked: leave it away")
        for path in (self.save, self.csv, self.save_rankings, *(self.list_photos or ())):
            if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
                raise BenchmarkError(f"{path} cannot be written: name a file in a folder that is there")

    def _benchmark(self) -> Benchmark:
        if self.protocol is not None:
            return self._named(self.protocol)
        if self.data is not None:
            raise BenchmarkError(
                f"--data {self.data} is a set of no protocol: name one with --protocol (salad datasets lists them)"
            )
        if self.references is None or self.queries is None:
            missing = "--references" if self.references is None else "--queries"
            raise BenchmarkError(
                f"{missing} is missing: name both folders, or a published set with --protocol and --data"
            )
        return benchmark_of(
            self.references, self.queries, truth=self.truth, frames=self.frames, radius=self.radius
        )

    def _named(self, protocol: str) -> Benchmark:
        from salad.data.protocols import read

        if (self.data is None) == (self.references is None):
            raise BenchmarkError(
                f"the set of {protocol} is one folder: name it with --data, or your own two with --references and "
                "--queries"
            )
        return read(
            protocol,
            self.data or self.references or Path(),
            queries=self.queries,
            metres=self.radius,
            tolerance=self.frames,
            truth=self.truth,
            any_size=self.any_size,
        )

    def _judged(self, benchmark: Benchmark) -> Result:
        from salad.evaluation import Terms, evaluate, evaluate_descriptors, evaluate_rankings

        terms = Terms(seed=self.seed)
        if self.descriptors is not None:
            name = self.called or self.descriptors[1].stem
            return evaluate_descriptors(benchmark, *self.descriptors, name=name, terms=terms)
        if self.rankings is not None:
            return evaluate_rankings(
                benchmark, self.rankings, name=self.called or self.rankings.stem, terms=terms
            )
        from salad.model.weights import load

        model = load(self.model, device=self.device, heads=self.heads)
        with shell.progress("describing") as bar:
            return evaluate(benchmark, model, cache=self.cache, seed=self.seed, progress=bar)

    def _listed(self, benchmark: Benchmark, references: Path, queries: Path) -> int:
        from salad.evaluation.outside import write_photos

        for photos, path in ((benchmark.references, references), (benchmark.queries, queries)):
            write_photos(photos, path)
            shell.say(f"{len(photos)} photos written to {path}")
        return shell.FOUND

    def _write(self, result: Result) -> None:
        from salad.evaluation.outside import write_rankings
        from salad.evaluation.saving import write_csv, write_result

        for write, path in (
            (write_result, self.save),
            (write_csv, self.csv),
            (write_rankings, self.save_rankings),
        ):
            if path is not None:
                write(result, path)
                shell.say(f"written to {path}")
