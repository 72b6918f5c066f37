"""From a benchmark and whatever answers it to a result: a model, or descriptors or ranked lists from outside."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salad.datasets.benchmark import Benchmark, Unanswerable
from salad.errors import BenchmarkError
from salad.evaluation.bootstrap import TIMES, SamplingDesign
from salad.evaluation.descriptors import describe_sides
from salad.evaluation.external import read_descriptors, read_rankings
from salad.evaluation.leaks import find_leaks
from salad.evaluation.metrics import KS, distances, precision_recall, recall
from salad.evaluation.result import QueryResult, Ranked, Reference, Result, along, below, digests_of, folder_of
from salad.geo import metres_between
from salad.localize.locate import calibration_of
from salad.search.base import DamagedRowError, Rows, SearcherFactory
from salad.search.exact import ExactSearcher
from salad.search.hubness import Centred, mean_of_all

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike


CENTRED = "scores leave out what all references have in common, as `salad locate` does with this model"
NO_DESCRIPTOR = (
    "the descriptor of {role} {row} (from 0) holds NaN, infinity or numbers too large to multiply: check the model and "
    "the photo it came from"
)
DRIVES = ("frames", "nordland")  # protocols whose queries are the frames of one drive


@dataclass(frozen=True, slots=True)
class EvalSettings:
    """How a benchmark is judged.

    Attributes:
        ks: Which recalls to report.
        unanswerable: Whether queries without a right reference are left out or are misses; the benchmark's own rule
            where not given.
        seed: Of the draws that tell how sure the figures are.
        times: How many draws.
    """

    ks: Sequence[int] = KS
    unanswerable: Unanswerable | None = None
    seed: int = 0
    times: int = TIMES

    def check(self, benchmark: Benchmark) -> None:
        """Refuse a senseless k or a set without an answer now, not after an hour of describing.

        Raises:
            BenchmarkError: If there would be no recall to give.
        """
        if not self.ks or min(self.ks) < 1:
            raise BenchmarkError(f"recall at {list(self.ks)} makes no sense: give whole numbers from 1")
        # Where they count as misses, nothing but misses is an answer too: 0 %.
        rule = self.unanswerable or benchmark.unanswerable_rule
        if rule != "miss" and not any(right.size for right in benchmark.positives):
            raise BenchmarkError(
                f"none of {len(benchmark.positives)} queries has a right reference, so there is no recall to give: "
                "check the ground truth, the tolerance or the radius"
            )


def evaluate(
    benchmark: Benchmark,
    model: DescriberLike,
    *,
    ks: Sequence[int] = KS,
    batch_size: int = 16,
    unanswerable: Unanswerable | None = None,
    cache: Path | None = None,
    seed: int = 0,
    plain: bool = False,
    threads: int | None = None,
    searcher: SearcherFactory = ExactSearcher,
    progress: Callable[[int, int], None] | None = None,
) -> Result:
    """Describe both sides of a benchmark, rank, and judge.

    Args:
        benchmark: The set and its ground truth.
        model: What turns photos into descriptors.
        ks: Which k to report; a k beyond the number of references asks whether any is right.
        batch_size: Photos described at once.
        unanswerable: Whether queries without positives are left out (`drop`) or count as misses (`miss`); by default
            as the benchmark's protocol says.
        cache: A folder of descriptors to take from and to add to; without it none is kept.
        seed: Of the draws that tell how sure the figures are.
        plain: Compare descriptors as they are, as published figures do, where the model's own way is to leave out what
            all references have in common (`salad.search.hubness`).
        threads: Photos read at a time; one a processor where not given.
        searcher: What finds the references of each query; another than the exact one shows what it costs.
        progress: Told how many photos are described, and of how many.

    Raises:
        BenchmarkError: If a photo cannot be read (a figure with holes is no figure), no query has an answer, or the
            cache cannot be written.
        ModelError: If the model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    settings = EvalSettings(ks, unanswerable, seed)
    settings.check(benchmark)
    began = time.perf_counter()
    references, queries = describe_sides(
        benchmark, model, batch_size=batch_size, cache=cache, threads=threads, progress=progress
    )
    centred = calibration_of(model).centred  # judged as `locate` uses it, unless asked for the published way
    ranked = rank(queries, references, k=max(ks), centred=centred and not plain, searcher=searcher)
    return judge(
        benchmark,
        ranked,
        settings,
        # A figure got in another way than the model's own must not stand under its bare name.
        model=f"{model.name}, plain" if centred and plain else model.name,
        notes=(CENTRED,) if centred and not plain else (),
        fingerprint=model.fingerprint,
        seconds=time.perf_counter() - began,
    )


def evaluate_descriptors(
    benchmark: Benchmark,
    references: Path,
    queries: Path,
    *,
    name: str,
    settings: EvalSettings | None = None,
    searcher: SearcherFactory = ExactSearcher,
) -> Result:
    """Judge descriptors that somebody else made: two `.npy` files, rows in the order of the benchmark's photos.

    Args:
        benchmark: The set and its ground truth.
        references: Descriptors of the references, `[references, dim]`.
        queries: Descriptors of the queries, `[queries, dim]`.
        name: What to call the method.
        settings: How to judge, where not as usual.
        searcher: What finds the references of each query.

    Raises:
        BenchmarkError: If a file cannot be read or does not fit the set, or no query has an answer.
    """
    settings = settings or EvalSettings()
    settings.check(benchmark)
    began = time.perf_counter()
    known, asked, notes = read_descriptors(benchmark, references, queries)
    # Never centred: what comes from outside is compared as whoever made it compares it.
    ranked = rank(asked, known, k=max(settings.ks), searcher=searcher)
    seconds = time.perf_counter() - began
    return judge(benchmark, ranked, settings, model=name, seconds=seconds, notes=notes)


def evaluate_rankings(
    benchmark: Benchmark, rankings: Path, *, name: str, settings: EvalSettings | None = None
) -> Result:
    """Judge ranked lists that somebody else made, in the form of the MSLS challenge.

    Args:
        benchmark: The set and its ground truth.
        rankings: The file.
        name: What to call the method.
        settings: How to judge, where not as usual; a k beyond the longest list is left out.

    Raises:
        BenchmarkError: If the file cannot be read or does not fit the set, or no query has an answer.
    """
    settings = settings or EvalSettings()
    settings.check(benchmark)
    began = time.perf_counter()
    ranked, notes = read_rankings(benchmark, rankings)
    # Beyond the longest list nothing was asked of the method, unless that list holds all there is.
    deepest = ranked.rows.shape[1]
    whole = deepest >= len(benchmark.references)
    settings = replace(settings, ks=tuple(k for k in settings.ks if k <= deepest or whole) or (1,))
    seconds = time.perf_counter() - began
    return judge(benchmark, ranked, settings, model=name, seconds=seconds, notes=notes)


def rank(
    queries: Rows,
    references: Rows,
    *,
    k: int,
    centred: bool = False,
    searcher: SearcherFactory = ExactSearcher,
) -> Ranked:
    """Find the references with the highest dot products with each query.

    Queries are held in memory; of the references it is the searcher's affair.

    Args:
        queries: `[queries, dim]`, of any length.
        references: `[references, dim]`, of any length.
        k: How many to keep; no more than there are references come back.
        centred: Whether scores leave out what all references have in common (`salad.search.hubness`).
        searcher: What finds them.

    Raises:
        BenchmarkError: If the two sides do not fit, or hold numbers that are not finite.
    """
    if queries.dim != references.dim:
        raise BenchmarkError(
            f"queries have {queries.dim} numbers each and references {references.dim}: describe both with one model"
        )
    # One copy of the queries for all passes over the references, which may lie in files.
    asked = queries.take(np.arange(len(queries))).astype(np.float32, copy=False)
    # A sum of squares shows what is not finite, and what is too large to multiply as well.
    with np.errstate(over="ignore", invalid="ignore"):
        bad = np.flatnonzero(~np.isfinite(np.einsum("ij,ij->i", asked, asked)))
    if bad.size:
        raise BenchmarkError(NO_DESCRIPTOR.format(role="query", row=int(bad[0])))
    try:
        finds = searcher(references)
        if centred:
            finds = Centred(finds, mean_of_all(references))
        hits = finds.search(asked, k=k)
    except DamagedRowError as error:
        raise BenchmarkError(NO_DESCRIPTOR.format(role="reference", row=error.row)) from error
    return Ranked(hits.rows, hits.scores)


def judge(
    benchmark: Benchmark,
    ranked: Ranked,
    settings: EvalSettings,
    *,
    model: str,
    fingerprint: str = "",
    seconds: float = 0.0,
    notes: Sequence[str] = (),
) -> Result:
    """Judge what was found for each query.

    Args:
        benchmark: The set and its ground truth, for which `settings.check` has passed.
        ranked: The references found for each query, best first.
        settings: How to judge.
        model: What to call whatever found them.
        fingerprint: The model's, where it has one.
        seconds: How long it took.
        notes: Sentences to add to the benchmark's own.

    Raises:
        BenchmarkError: If there is not one ranking a query.
    """
    references, queries = folder_of(benchmark.references), folder_of(benchmark.queries)
    per_query = query_results(benchmark, ranked, queries)
    rule = settings.unanswerable or benchmark.unanswerable_rule
    said = ""
    if rule != benchmark.unanswerable_rule:  # the protocol's own rule is part of what its name means
        said = f", unanswerable queries {'count as misses' if rule == 'miss' else 'left out'}"
    counted = np.array([number for number, one in enumerate(per_query) if rule == "miss" or one.positives])
    # Queries of one group, and neighbouring frames of one drive, are right and wrong together.
    if benchmark.groups is not None and len(set(benchmark.groups)) > 1:
        design = SamplingDesign("group", groups=benchmark.groups)
    elif benchmark.protocol.startswith(DRIVES):
        design = SamplingDesign("block", order=along([photo.path for photo in benchmark.queries]))
    else:
        design = SamplingDesign("query")
    design = replace(design, seed=settings.seed, times=settings.times)
    percent, intervals, drawn = recall(per_query, counted, settings.ks, design)
    named = sorted({row for one in per_query for row in (*one.matches, one.right) if row is not None})
    return Result(
        benchmark=benchmark.name,
        protocol=benchmark.protocol + said,
        queries=len(benchmark.queries),
        references=len(benchmark.references),
        unanswerable=sum(not one.positives for one in per_query),
        recall=percent,
        model=model,
        seconds=seconds,
        notes=(*benchmark.notes, *notes),
        fingerprint=fingerprint,
        unanswerable_rule=rule,
        intervals=intervals,
        drawn=drawn,
        precision_recall=precision_recall(per_query, design),
        distances=distances(per_query, counted, design),
        per_query=per_query,
        known={row: Reference.of(benchmark.references[row], references) for row in named},
        folders=(references, queries),
        digests=digests_of(benchmark, references),
    )


def query_results(benchmark: Benchmark, ranked: Ranked, folder: str) -> tuple[QueryResult, ...]:
    """What became of each query, named by its path below a folder.

    Raises:
        BenchmarkError: If there is not one ranking a query.
    """
    if len(ranked.rows) != len(benchmark.queries):
        raise BenchmarkError(f"{len(ranked.rows)} rankings but {len(benchmark.queries)} queries: give one of each")
    results = []
    for number, (rows, right) in enumerate(zip(ranked.rows, benchmark.positives, strict=True)):
        query = benchmark.queries[number]  # once: of a large set photos are made as they are asked for
        found = rows >= 0  # searches pad with -1
        hits = np.flatnonzero(np.isin(rows, right))
        first = rows[hits[0]] if hits.size else right[0] if len(right) else None
        best = benchmark.references[int(rows[0])].where if found[:1].any() else None
        results.append(
            QueryResult(
                query=below(query.path, folder),
                positives=len(right),
                first_right=int(hits[0]) + 1 if hits.size else None,
                matches=tuple(rows[found].tolist()),
                scores=None if ranked.scores is None else tuple(ranked.scores[number][found].tolist()),
                right=None if first is None else int(first),
                metres=metres_between(query.where, best) if query.where and best else None,
                where=(query.where.lat, query.where.lon) if query.where else None,
                group=benchmark.groups[number] if benchmark.groups is not None else None,
            )
        )
    return tuple(results)


def with_leaks(result: Result, benchmark: Benchmark) -> Result:
    """The result with the photos that are in both sides.

    Raises:
        BenchmarkError: If a photo cannot be read.
    """
    scores = [one.scores for one in result.per_query if one.scores is not None]
    # Only cosines tell what is alike enough to be looked at; descriptors from outside may be of any length.
    cosines = all(abs(score) <= 1.01 for some in scores for score in some)
    leaks = find_leaks(
        benchmark.queries,
        benchmark.references,
        matches=[one.matches for one in result.per_query],
        scores=scores if len(scores) == len(result.per_query) and cosines else None,
    )
    return replace(result, leaks=leaks)
