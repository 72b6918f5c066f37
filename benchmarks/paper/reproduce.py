"""The paper's rows on your own copies of its data sets: ours beside the paper's, by named protocol.

    bash scripts/reproduce-paper DATA [--medium FILE] [--small FILE] [--runs DIR] [--device NAME]

DATA is a folder that holds the data sets, each in a folder of its own in whatever layout it came; or name them with
--msls-val, --nordland, --pitts250k and --sped. `salad datasets` tells where to get them. What is not there is said and
passed over. The full model and the bare backbone are fetched by name; the medium and the small one are files you
give. --runs is a folder of `salad compare` or of `benchmarks/accuracy/results.py`: every model it holds is a row. The
other methods of the first table run in their own code: `salad evaluate --descriptors ... --save FILE` judges what that
gives, and --result METHOD FILE puts it in.

Descriptors are kept in TO/descriptors (gigabytes), so that the same command goes on where it was stopped. TO gets
reproduction.md and reproduction.json after every figure, and each whole result for `salad compare A.json B.json`.
Leaves with 0 where every figure is within a point of the paper's, 1 where one is not, 2 where nothing could be run.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.machine import conditions
from benchmarks.options import RUNS
from benchmarks.paper.figures import METHODS, first, protocols
from benchmarks.paper.page import Figure, Judged, Report
from benchmarks.paper.rows import FULL, Row, check_given, rows, unlike
from benchmarks.paper.sets import find_set
from salad.cli import terminal
from salad.cli.arguments import positive
from salad.cli.stopping import INTERRUPTED
from salad.datasets.benchmark import Benchmark
from salad.datasets.protocols import read
from salad.errors import BenchmarkError, SaladError
from salad.evaluation.evaluate_benchmark import evaluate
from salad.evaluation.result import read_result, write_result
from salad.files import write_whole
from salad.models.model_folder import load as load_model
from salad.training.devices import versions

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

OPTIONS = {
    "msls-val-740": "msls_val",
    "nordland-1f": "nordland",
    "pitts250k-test": "pitts250k",
    "sped": "sped",
}
BARE = "dinov2-vitb14"
Load = Callable[..., "DescriberLike"]


def main(arguments: Sequence[str] | None = None, *, load: Load | None = None) -> int:
    """Run it; the exit code."""
    asked = _parser().parse_args(arguments)
    try:
        return _run(asked, load or load_model)
    except (SaladError, OSError) as error:
        terminal.say(f"reproduce-paper: {error}")
        return terminal.BAD_INPUT
    except KeyboardInterrupt:
        terminal.say("reproduce-paper: interrupted; the same command goes on where it stopped")
        return INTERRUPTED


def _run(asked: argparse.Namespace, load: Load) -> int:
    positive(asked.batch_size, "batch-size")
    sizes = {"full": asked.full, "medium": asked.medium, "small": asked.small}
    wanted = rows(sizes, asked.backbone or [BARE], asked.runs or [], asked.only or [])
    for row in wanted:
        if row.given:
            check_given(row, load(row.spec, device="cpu"))
    report = Report(
        made={**conditions(), "device": asked.device, "versions": versions()},
        figures=[_outside(*each) for each in asked.result or []],
    )
    benchmarks = _benchmarks(asked, report)
    if not benchmarks and not report.figures:
        raise BenchmarkError("there is no data set to run on: name the folder that holds them")
    (asked.to / "results").mkdir(parents=True, exist_ok=True)
    for row in wanted if benchmarks else []:
        for figure in _figures(row, benchmarks, asked, report, load):
            report.figures.append(figure)
            _write(report, asked.to)
    _write(report, asked.to)
    terminal.write(report.markdown().rstrip())
    terminal.say(f"written to {asked.to / 'reproduction.md'} and .json")
    if not report.figures:
        raise BenchmarkError("no model could be run: see above")
    return terminal.NOTHING if report.over else terminal.FOUND


def _benchmarks(asked: argparse.Namespace, report: Report) -> list[Benchmark]:
    """The sets that are there; what is missing is said and noted.

    Raises:
        BenchmarkError: If a folder that was named for a set is not that set.
    """
    if asked.data is not None and not asked.data.is_dir():
        raise BenchmarkError(f"there is no folder {asked.data}: name the one that holds the data sets")
    found = []
    for name in protocols():
        given: Path | None = getattr(asked, OPTIONS[name])
        if given is not None:
            found.append(read(name, given, any_size=asked.any_size))
            continue
        try:
            found.append(find_set(name, asked.data, any_size=asked.any_size))
        except BenchmarkError as error:
            _pass_over(report, str(error))
    return found


def _figures(
    row: Row, benchmarks: Sequence[Benchmark], asked: argparse.Namespace, report: Report, load: Load
) -> Iterator[Figure]:
    """One model on every set; what cannot be run is said and noted, and the rest goes on."""
    try:
        model = load(row.spec, device=asked.device)
    except SaladError as error:
        _pass_over(report, f"{row.claim.title}: {error}")
        return
    judged = Judged(
        *(row.name, row.claim, row.spec, model.dim, model.fingerprint),
        image=(model.preprocessing.height, model.preprocessing.width),
        trained=row.trained,
        unlike=tuple(unlike(row.claim, model)),
    )
    cache = asked.to / "descriptors"
    for benchmark in benchmarks:
        photos = len(benchmark.references) + len(benchmark.queries)
        terminal.say(
            f"{row.claim.title} on {benchmark.protocol}: {photos:,} photos, {photos * model.dim * 4 / 1e9:.1f} GB "
            f"of descriptors in {cache}"
        )
        try:
            with terminal.progress("describing") as bar:
                result = evaluate(benchmark, model, batch_size=asked.batch_size, cache=cache, progress=bar)
        except SaladError as error:
            _pass_over(report, f"{row.claim.title} on {benchmark.protocol}: {error}")
            continue
        slug = re.sub(r"[^\w.-]+", "-", f"{row.name}-{result.protocol}")
        write_result(result, asked.to / "results" / f"{slug}.json")
        yield Figure(judged, result)


def _outside(method: str, saved: str) -> Figure:
    """A method of the first table that was judged before, from a saved result.

    Raises:
        BenchmarkError: If the paper has no such method, or the result cannot be read or has no R@1 and R@5.
    """
    if method not in METHODS:
        raise BenchmarkError(f"--result {method}: the paper's first table has {', '.join(METHODS)}")
    result = read_result(Path(saved))
    if not {1, 5} <= result.recall.keys():
        raise BenchmarkError(f"{saved} has no R@1 and R@5: judge that method's five best matches or more")
    said = first(method)
    claim = replace(said, title=f"{said.title}, {result.model}")
    return Figure(Judged(f"{method}-{saved}", claim, saved, None, result.fingerprint, None), result)


def _pass_over(report: Report, sentence: str) -> None:
    terminal.say(f"passed over: {sentence}")
    report.missing.append(sentence)


def _write(report: Report, to: Path) -> None:
    text = json.dumps(report.as_dict(), ensure_ascii=False, indent=1, allow_nan=False)
    write_whole(to / "reproduction.json", f"{text}\n".encode())
    write_whole(to / "reproduction.md", report.markdown().encode())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="reproduce-paper", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, nargs="?", metavar="DATA", help="the folder of all data sets")
    for name, option in OPTIONS.items():
        flag = f"--{option.replace('_', '-')}"
        parser.add_argument(flag, type=Path, metavar="DIR", help=f"the folder of {name}'s set")
    parser.add_argument("--full", default=FULL, metavar="NAME|DIR|FILE", help="default: %(default)s")
    parser.add_argument("--medium", metavar="DIR|FILE", help="the paper's model of 2,112 numbers")
    parser.add_argument("--small", metavar="DIR|FILE", help="the paper's model of 544 numbers")
    parser.add_argument(
        "--backbone", action="append", metavar="NAME|FILE", help=f"a backbone as it is; default: {BARE}"
    )
    parser.add_argument("--runs", type=Path, action="append", metavar="DIR", help="trained rows")
    parser.add_argument(
        "--result",
        nargs=2,
        action="append",
        metavar=("METHOD", "FILE"),
        help="one of the table, judged before",
    )
    parser.add_argument("--only", action="append", metavar="ROW", help="a row by name, where not all")
    parser.add_argument("--to", type=Path, default=RUNS / "paper", metavar="DIR")
    parser.add_argument("--device", default="cpu", help="where models run, as torch names it")
    parser.add_argument("--batch-size", type=int, default=16, metavar="N")
    parser.add_argument("--any-size", action="store_true", help="take parts of sets, compared with nothing")
    return parser


if __name__ == "__main__":
    sys.exit(main())
