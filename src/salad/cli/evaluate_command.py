"""`salad evaluate`: any model, or any other method's descriptors or rankings, judged under a named protocol."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from salad.cli import evaluation_tables, terminal
from salad.cli.arguments import (
    SHIPPED,
    Degrees,
    Engine,
    Folder,
    Format,
    Metres,
    Number,
    Table,
    Threads,
    benchmark_of,
    check_positions,
    check_threads,
    read_positions,
    settle_engine,
)
from salad.errors import BenchmarkError

if TYPE_CHECKING:
    from salad.datasets.benchmark import Benchmark
    from salad.evaluation.result import Result
    from salad.models.describer import DescriberLike


Text = Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")]
FilePath = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
TwoFiles = Annotated[tuple[Path, Path] | None, arg(metavar="REFERENCES.npy QUERIES.npy", help_behavior_hint="")]
TwoNames = Annotated[tuple[Path, Path] | None, arg(metavar="REFERENCES.txt QUERIES.txt", help_behavior_hint="")]

_JUDGING = (  # options that decide how a set is judged, and so come too late for a result that is saved
    *("truth", "frames", "radius", "heading", "table", "protocol", "data", "layout", "any_size"),
    *("descriptors", "rankings", "list_photos", "called", "cache", "leaks", "plain"),
)


@dataclass(frozen=True)
class EvaluateCommand:
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
    heading: Degrees = None
    """With a radius: right only where both photos look the same way within so many degrees."""
    table: Table = None
    """With a radius: where photos were taken that do not say so themselves, as `path,lat,lon`."""
    protocol: Text = None
    """A published protocol by its name, which says what is right."""
    data: Folder = None
    """The folder of that protocol's data set."""
    layout: Text = None
    """How that data set lies on disk, where several ways fit; `salad datasets check DIR` tells."""
    any_size: bool = False
    """Take a set whose counts are not the protocol's; its figures then say so."""
    model: Annotated[str, arg(metavar="NAME|DIR|FILE")] = SHIPPED
    """A name of the zoo, a folder or a published file."""
    heads: Number = None
    """Attention heads of a published file that are not width / 64."""
    device: str = "cpu"
    """Where the model runs, as torch names it."""
    engine: Engine = "auto"
    threads: Threads = None
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
    result: FilePath = None
    """Judge nothing: take the result that --save wrote. --references and --queries then say where the photos are that
    a page shows."""
    save: FilePath = None
    """Write the whole result as JSON, for `salad compare`."""
    report: FilePath = None
    """Write a page of it: figures, curves, a map of right and wrong, the mistakes with their photos."""
    heat: bool = False
    """With --result: let --model look at the page's photos again, to show what its dustbin took."""
    csv: FilePath = None
    """Write a table with one line a query."""
    save_rankings: FilePath = None
    """Write what was found as lines `query_key ref_key ref_key ...`."""
    plain: bool = False
    """Compare a model's descriptors as they are, as published figures do, where its own way is to leave out what all
    references have in common."""
    seed: int = 0
    """Of the draws that tell how sure the figures are."""
    format: Format = "table"

    def run(self) -> int:
        """Evaluate."""
        from salad.evaluation.evaluate_benchmark import with_leaks

        self._refuse_early()
        if self.result is not None:
            result, model = self._read_saved(self.result)
        else:
            benchmark = self._benchmark()
            if self.list_photos is not None:
                return self._write_lists(benchmark, *self.list_photos)
            result, model = self._judge(benchmark)
            if self.leaks:
                result = with_leaks(result, benchmark)
        # Files first: where the terminal goes away meanwhile, what took an hour is on the disk.
        self._write_files(result, model)
        # To stderr, so that --format json stays JSON.
        for note in (*result.notes, *evaluation_tables.leak_sentences(result)):
            terminal.say(note)
        if self.format == "json":
            terminal.write_json(result.as_dict())
        else:
            terminal.write_fields(evaluation_tables.summary(result))
            terminal.write_table(evaluation_tables.figures(result))
        return terminal.FOUND

    def _refuse_early(self) -> None:
        """Refuse before any work what would come to nothing after it."""
        check_threads(self.threads)
        outside = self.descriptors is not None or self.rankings is not None
        if self.descriptors is not None and self.rankings is not None:
            raise BenchmarkError("--descriptors and --rankings are two methods: judge one at a time")
        if self.cache is not None and outside:
            raise BenchmarkError("--cache keeps what a model describes, and no model is asked: leave it away")
        if self.plain and outside:
            raise BenchmarkError("what comes from outside is compared as it is: leave --plain away")
        if self.heat and (self.result is None or self.report is None):
            raise BenchmarkError(
                "--heat is for a page of a saved result: give it with --result and --report (a page made while judging "
                "a model has its heat maps already)"
            )
        # What cannot be written is refused now, not after an hour of describing.
        for path in (self.save, self.report, self.csv, self.save_rankings, *(self.list_photos or ())):
            if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
                raise BenchmarkError(f"{path} cannot be written: name a file in a folder that is there")

    def _benchmark(self) -> Benchmark:
        """The set that the options name: a published one under its protocol, or two folders and a rule."""
        if self.protocol is not None:
            return self._published(self.protocol)
        if self.data is not None:  # a folder of a data set says nothing of what is right in it
            raise BenchmarkError(
                f"--data {self.data} is a set of no protocol: name one with --protocol (salad datasets lists them)"
            )
        if self.references is None or self.queries is None:
            missing = "--references" if self.references is None else "--queries"
            raise BenchmarkError(
                f"{missing} is missing: name both folders, or a published set with --protocol and --data"
            )
        if self.layout is not None:
            raise BenchmarkError(f"--layout {self.layout} is of a published set: name it with --protocol and --data")
        return benchmark_of(
            self.references,
            self.queries,
            truth=self.truth,
            frames=self.frames,
            radius=self.radius,
            heading=self.heading,
            table=self.table,
        )

    def _published(self, protocol: str) -> Benchmark:
        from salad.datasets.protocols import read

        if (self.data is None) == (self.references is None):
            raise BenchmarkError(
                f"the set of {protocol} is one folder: name it with --data, or your own two with --references and "
                "--queries"
            )
        positions = read_positions(self.table)
        made = read(
            protocol,
            self.data or self.references or Path(),  # one of the two is there: see above
            queries=self.queries,
            metres=self.radius,
            tolerance=self.frames,
            heading=self.heading,
            table=positions,
            truth=self.truth,
            layout=self.layout,
            any_size=self.any_size,
        )
        check_positions(positions, made)
        return made

    def _read_saved(self, path: Path) -> tuple[Result, DescriberLike | None]:
        """A result that was judged before, and the model it is of, where its heat maps are wanted."""
        from salad.evaluation.result import read_result

        for name in _JUDGING:
            if getattr(self, name) not in (None, False):  # what is not given is one of these, never 0 or ""
                option = name.replace("_", "-")
                raise BenchmarkError(f"{path} is judged already, so --{option} changes nothing: leave it away")
        result = read_result(path)
        # A result holds photos' paths below two folders, which may have moved since, or lie on another machine.
        references, queries = result.folders
        result = replace(result, folders=(str(self.references or references), str(self.queries or queries)))
        if not self.heat:
            return result, None
        model = self._model()
        if model.fingerprint != result.fingerprint:  # a name may stand for other weights by now
            raise BenchmarkError(
                f"the result is of {result.model} ({result.fingerprint or 'no model of ours'}), and {model.name} "
                f"({model.fingerprint}) would show what another threw away: name its own with --model, or leave "
                "--heat away"
            )
        return result, model

    def _model(self) -> DescriberLike:
        from salad.models.model_folder import load

        return load(self.model, device=self.device, heads=self.heads, engine=self.engine, threads=self.threads)

    def _judge(self, benchmark: Benchmark) -> tuple[Result, DescriberLike | None]:
        """What a model, or what comes from outside, reaches on a set; and the model, where there is one."""
        from salad.evaluation.evaluate_benchmark import EvalSettings, evaluate, evaluate_descriptors, evaluate_rankings

        settings = EvalSettings(seed=self.seed)
        if self.descriptors is not None:
            name = self.called or self.descriptors[1].stem
            return evaluate_descriptors(benchmark, *self.descriptors, name=name, settings=settings), None
        if self.rankings is not None:
            name = self.called or self.rankings.stem
            return evaluate_rankings(benchmark, self.rankings, name=name, settings=settings), None
        model = self._model()
        settle_engine(model, len(benchmark.references) + len(benchmark.queries))
        with terminal.progress("describing") as bar:
            result = evaluate(
                benchmark,
                model,
                cache=self.cache,
                seed=self.seed,
                plain=self.plain,
                threads=self.threads,
                progress=bar,
            )
        return result, model

    def _write_lists(self, benchmark: Benchmark, references: Path, queries: Path) -> int:
        from salad.evaluation.external import write_photos

        for photos, path in ((benchmark.references, references), (benchmark.queries, queries)):
            write_photos(photos, path)
            terminal.say(f"{len(photos)} photos written to {path}")
        return terminal.FOUND

    def _write_files(self, result: Result, model: DescriberLike | None) -> None:
        from salad.evaluation.external import write_rankings
        from salad.evaluation.result import write_csv, write_result

        for write, path in (
            (write_result, self.save),
            (write_csv, self.csv),
            (write_rankings, self.save_rankings),
        ):
            if path is not None:
                write(result, path)
                terminal.say(f"written to {path}")
        if self.report is not None:
            from salad.report.evaluation_page import write_report

            # A saved result's own folders are what its file says, and no picture is taken from there.
            named = None if self.result is None else (self.references, self.queries)
            for sentence in write_report(result, self.report, model, folders=named):
                terminal.say(sentence)
            terminal.say(f"written to {self.report}")
