"""From a benchmark and whatever answers it to a result: a model, or descriptors or ranked lists from outside."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from salad.datasets.benchmark import Benchmark, Unanswerable
from salad.errors import BenchmarkError
from salad.evaluation import metrics
from salad.evaluation.bootstrap import (
    TIMES,
    Design,
    Interval,
    Plan,
    nested,
    percentile_interval,
    share_interval,
)
from salad.evaluation.descriptors import Cache, Described
from salad.evaluation.external import depth, read_descriptors, read_rankings
from salad.evaluation.leaks import find_leaks
from salad.evaluation.metrics import KS, Answers, check_countable
from salad.evaluation.result import (
    Distances,
    PrecisionRecall,
    QueryResult,
    Ranked,
    Result,
    along,
    answers,
    folder_of,
    known,
    names_digest,
    rows_digest,
    verdicts_of,
)
from salad.localize.locate import calibration_of
from salad.search.base import DamagedRowError, Rows, SearcherFactory
from salad.search.exact import ExactSearcher
from salad.search.hubness import Centred, mean_of_all

if TYPE_CHECKING:
    from salad.models.describer import Describes


# --- From what was found for each query to a result: recall, curve, metres, each with how sure it is ---


DRIVES = ("frames", "nordland")  # protocols whose queries are the frames of one drive
Statistic = Callable[[Float64[np.ndarray, "draws queries"]], Float64[np.ndarray, "draws figures"]]


@dataclass(frozen=True, slots=True)
class EvalSettings:
    """On what settings a benchmark is judged.

    Attributes:
        ks: which recalls to report.
        unanswerable: whether queries without a right reference are left out or are misses; the benchmark's own rule
            where not given.
        seed: of the draws that tell how sure the figures are.
        times: how many draws.
    """

    ks: Sequence[int] = KS
    unanswerable: Unanswerable | None = None
    seed: int = 0
    times: int = TIMES

    def rule(self, benchmark: Benchmark) -> Unanswerable:
        """What becomes of queries without a right reference."""
        return self.unanswerable or benchmark.unanswerable_rule

    def check(self, benchmark: Benchmark) -> None:
        """Refuse a senseless k or a set without an answer now, not after an hour of describing.

        Raises:
            BenchmarkError: there would be no recall to give.
        """
        check_countable(benchmark.positives, self.ks, unanswerable=self.rule(benchmark))


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
        benchmark: the set and its ground truth.
        ranked: the references found for each query, best first.
        settings: on what settings.
        model: what to call whatever found them.
        fingerprint: the model's, where it has one.
        seconds: how long it took.
        notes: sentences to add to the benchmark's own.

    Raises:
        BenchmarkError: there is not one ranking a query, or no recall to give.
    """
    settings.check(benchmark)
    if len(ranked.rows) != len(benchmark.queries):
        raise BenchmarkError(
            f"{len(ranked.rows)} rankings but {len(benchmark.queries)} queries: give one of each"
        )
    folders = folder_of(benchmark.references), folder_of(benchmark.queries)
    verdicts = verdicts_of(benchmark, ranked, folders[1])
    rule = settings.rule(benchmark)
    result = Result(
        benchmark=benchmark.name,
        protocol=benchmark.protocol + _said(rule, benchmark.unanswerable_rule),
        queries=len(benchmark.queries),
        references=len(benchmark.references),
        unanswerable=sum(not one.positives for one in verdicts),
        recall={},
        model=model,
        seconds=seconds,
        notes=(*benchmark.notes, *notes),
        fingerprint=fingerprint,
        unanswerable_rule=rule,
        per_query=verdicts,
        known=known(benchmark, verdicts, folders[0]),
        folders=folders,
        digests=(names_digest(benchmark.references, folders[0]), rows_digest(benchmark.positives)),
    )
    return measured(result, settings, design_of(benchmark))


def measured(result: Result, settings: EvalSettings, design: Design) -> Result:
    """The result with every figure that its verdicts give."""
    recall, intervals, drawn = _recalls(result, settings, design)
    found = answers(result.per_query)
    return replace(
        result,
        recall=recall,
        intervals=intervals,
        drawn=drawn,
        precision_recall=None if found is None else _precision_recall(found, settings, design),
        distances=_distances(result, settings, design),
    )


def design_of(benchmark: Benchmark) -> Design:
    """Which queries hang together: those of a group where groups are known, and the frames of one drive."""
    if benchmark.groups is not None and len(set(benchmark.groups)) > 1:
        return Design("group", groups=benchmark.groups)
    if benchmark.protocol.startswith(DRIVES):
        return Design("block", order=along([photo.path for photo in benchmark.queries]))
    return Design("query")


# --- figures -------------------------------------------------------------------------------


def _recalls(
    result: Result, settings: EvalSettings, design: Design
) -> tuple[dict[int, float], dict[int, Interval], dict[str, object]]:
    those = np.array([number for number, one in enumerate(result.per_query) if result.counts(one)])
    hits = np.array(
        [[result.per_query[number].hit(k) for k in settings.ks] for number in those], dtype=np.float64
    )
    plan = design.plan(those, hits[:, 0])
    draws = _drawn(
        plan, settings, lambda weights: 100 * (weights @ hits) / weights.sum(axis=1, keepdims=True)
    )
    recall = {k: float(100.0 * hits[:, column].mean()) for column, k in enumerate(settings.ks)}
    intervals = {
        k: share_interval(recall[k], draws[:, column], units=plan.units, counted=len(those))
        for column, k in enumerate(settings.ks)
    }
    return recall, nested(intervals), {**plan.as_dict(), "times": settings.times, "seed": settings.seed}


def _precision_recall(found: Answers, settings: EvalSettings, design: Design) -> PrecisionRecall | None:
    if not np.isfinite(found.scores).any():
        return None
    plan = design.plan(np.arange(len(found.scores)), found.right.astype(np.float64))
    draws = _drawn(plan, settings, found.area_and_full)
    curve = found.curve()
    return PrecisionRecall(
        curve.area,
        curve.recall_at_full_precision,
        curve.surest,
        percentile_interval(draws[:, 0]),
        percentile_interval(draws[:, 1]),
    )


def _distances(result: Result, settings: EvalSettings, design: Design) -> Distances | None:
    counted = {number: one for number, one in enumerate(result.per_query) if result.counts(one)}
    apart = {number: _apart(one) for number, one in counted.items()}
    placed = {number: far for number, far in apart.items() if not math.isnan(far)}
    if not placed or all(map(math.isinf, placed.values())):
        return None
    far = np.array(list(placed.values()))
    plan = design.plan(np.array(list(placed)), (far <= metrics.WITHIN_M[-1]).astype(np.float64))
    draws = _drawn(
        plan,
        settings,
        lambda weights: np.column_stack(
            [metrics.distance_medians(far, weights), metrics.shares_within(far, weights)]
        ),
    )
    within = metrics.shares_within(far, np.ones((1, len(far))))[0]
    return Distances(
        known=len(far),
        median=float(np.median(far)),
        median_interval=percentile_interval(draws[:, 0]),
        within=dict(zip(metrics.WITHIN_M, within.tolist(), strict=True)),
        within_intervals={
            limit: share_interval(float(share), draw, units=plan.units, counted=len(far))
            for limit, share, draw in zip(metrics.WITHIN_M, within, draws[:, 1:].T, strict=True)
        },
    )


def _apart(one: QueryResult) -> float:
    if one.metres is not None:
        return one.metres
    return math.inf if one.where is not None and not one.matches else math.nan


def _drawn(plan: Plan, settings: EvalSettings, statistic: Statistic) -> Float64[np.ndarray, "draws figures"]:
    return np.concatenate(
        [statistic(some) for some in plan.weights(seed=settings.seed, times=settings.times)]
    )


def _said(rule: Unanswerable, own: Unanswerable) -> str:
    if rule == own:  # then it is part of what the protocol's name means
        return ""
    return f", unanswerable queries {'count as misses' if rule == 'miss' else 'left out'}"


CENTRED = "scores leave out what all references have in common, as `salad locate` does with this model"


def evaluate(
    benchmark: Benchmark,
    model: Describes,
    *,
    ks: Sequence[int] = KS,
    batch_size: int = 16,
    unanswerable: Unanswerable | None = None,
    cache: Path | None = None,
    seed: int = 0,
    plain: bool = False,
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
        searcher: What finds the references of each query; another than the exact one shows what it costs.
        progress: Told how many photos are described, and of how many.

    Raises:
        BenchmarkError: A photo cannot be read (a figure with holes is no figure), no query has an answer, or the cache
            cannot be written.
        ModelError: The model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    settings = EvalSettings(ks, unanswerable, seed)
    settings.check(benchmark)
    began = time.perf_counter()
    described = Described(model, batch_size=batch_size)
    source = described if cache is None else Cache(cache, described)
    references, queries = source.sides(benchmark.references, benchmark.queries, progress=progress)
    own = calibration_of(model).centred
    ranked = rank(queries, references, k=max(ks), centred=own and not plain, searcher=searcher)
    return judge(
        benchmark,
        ranked,
        settings,
        model=f"{model.name}, plain" if own and plain else model.name,
        notes=(CENTRED,) if own and not plain else (),
        fingerprint=model.fingerprint,
        seconds=time.perf_counter() - began,
    )


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
        BenchmarkError: The two sides do not fit, or hold numbers that are not finite.
    """
    if queries.dim != references.dim:
        raise BenchmarkError(
            f"queries have {queries.dim} numbers each and references {references.dim}: describe both with one model"
        )
    asked = queries.take(np.arange(len(queries))).astype(np.float32, copy=False)
    with np.errstate(over="ignore", invalid="ignore"):
        bad = np.flatnonzero(~np.isfinite(np.einsum("ij,ij->i", asked, asked)))
    if bad.size:
        raise _no_descriptor("query", int(bad[0]))
    try:
        finds = searcher(references)
        if centred:
            finds = Centred(finds, mean_of_all(references))
        hits = finds.search(asked, k=k)
    except DamagedRowError as error:
        raise _no_descriptor("reference", error.row) from error
    return Ranked(hits.rows, hits.scores)


def _no_descriptor(role: str, row: int) -> BenchmarkError:
    return BenchmarkError(
        f"the descriptor of {role} {row} (from 0) holds NaN, infinity or numbers too large to multiply: check the "
        "model and the photo it came from"
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
        benchmark: the set and its ground truth.
        references: descriptors of the references.
        queries: descriptors of the queries.
        name: what to call the method.
        settings: on what settings, where not the usual ones.
        searcher: what finds the references of each query.

    Raises:
        BenchmarkError: a file cannot be read or does not fit the set, or no query has an answer.
    """
    settings = settings or EvalSettings()
    settings.check(benchmark)
    began = time.perf_counter()
    known, asked, notes = read_descriptors(benchmark, references, queries)
    ranked = rank(asked, known, k=max(settings.ks), searcher=searcher)
    seconds = time.perf_counter() - began
    return judge(benchmark, ranked, settings, model=name, seconds=seconds, notes=notes)


def evaluate_rankings(
    benchmark: Benchmark, rankings: Path, *, name: str, settings: EvalSettings | None = None
) -> Result:
    """Judge ranked lists that somebody else made, in the form of the MSLS challenge.

    Args:
        benchmark: the set and its ground truth.
        rankings: the file.
        name: what to call the method.
        settings: on what settings, where not the usual ones; a k beyond the longest list is left out.

    Raises:
        BenchmarkError: the file cannot be read or does not fit the set, or no query has an answer.
    """
    settings = settings or EvalSettings()
    settings.check(benchmark)
    began = time.perf_counter()
    ranked, notes = read_rankings(benchmark, rankings)
    ks = depth(ranked, len(benchmark.references), settings.ks)
    seconds = time.perf_counter() - began
    return judge(benchmark, ranked, replace(settings, ks=ks), model=name, seconds=seconds, notes=notes)


def with_leaks(result: Result, benchmark: Benchmark) -> Result:
    """The result with the photos that are in both sides.

    Raises:
        BenchmarkError: a photo cannot be read.
    """
    matches = [one.matches for one in result.per_query]
    scores = [one.scores for one in result.per_query if one.scores is not None]
    found = find_leaks(
        benchmark.queries,
        benchmark.references,
        matches=matches,
        scores=scores if len(scores) == len(matches) and _are_cosines(scores) else None,
    )
    return replace(result, leaks=found)


def _are_cosines(scores: Sequence[Sequence[float]]) -> bool:
    return all(abs(score) <= 1.01 for told in scores for score in told)
