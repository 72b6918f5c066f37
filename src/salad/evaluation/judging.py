"""From what was found for each query to a result: recall, curve, metres, each with how sure it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from salad.data.benchmark import Benchmark, Unanswerable
from salad.errors import BenchmarkError
from salad.evaluation import metres
from salad.evaluation.curves import Answers
from salad.evaluation.intervals import (
    TIMES,
    Design,
    Interval,
    Plan,
    nested,
    percentile_interval,
    share_interval,
)
from salad.evaluation.ranking import Ranked
from salad.evaluation.recall import KS, check_countable
from salad.evaluation.result import Distances, PrecisionRecall, Result, Verdict, answers
from salad.evaluation.verdicts import along, folder_of, known, names_digest, rows_digest, verdicts_of

DRIVES = ("frames", "nordland")  # protocols whose queries are the frames of one drive
Statistic = Callable[[Float64[np.ndarray, "draws queries"]], Float64[np.ndarray, "draws figures"]]


@dataclass(frozen=True, slots=True)
class Terms:
    """On what terms a benchmark is judged.

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


def judged(
    benchmark: Benchmark,
    ranked: Ranked,
    terms: Terms,
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
        terms: on what terms.
        model: what to call whatever found them.
        fingerprint: the model's, where it has one.
        seconds: how long it took.
        notes: sentences to add to the benchmark's own.

    Raises:
        BenchmarkError: there is not one ranking a query, or no recall to give.
    """
    terms.check(benchmark)
    if len(ranked.rows) != len(benchmark.queries):
        raise BenchmarkError(
            f"{len(ranked.rows)} rankings but {len(benchmark.queries)} queries: give one of each"
        )
    folders = folder_of(benchmark.references), folder_of(benchmark.queries)
    verdicts = verdicts_of(benchmark, ranked, folders[1])
    rule = terms.rule(benchmark)
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
        verdicts=verdicts,
        known=known(benchmark, verdicts, folders[0]),
        folders=folders,
        digests=(names_digest(benchmark.references, folders[0]), rows_digest(benchmark.positives)),
    )
    return measured(result, terms, design_of(benchmark))


def measured(result: Result, terms: Terms, design: Design) -> Result:
    """The result with every figure that its verdicts give."""
    recall, intervals, drawn = _recalls(result, terms, design)
    found = answers(result.verdicts)
    return replace(
        result,
        recall=recall,
        intervals=intervals,
        drawn=drawn,
        precision_recall=None if found is None else _precision_recall(found, terms, design),
        distances=_distances(result, terms, design),
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
    result: Result, terms: Terms, design: Design
) -> tuple[dict[int, float], dict[int, Interval], dict[str, object]]:
    those = np.array([number for number, one in enumerate(result.verdicts) if result.counts(one)])
    hits = np.array(
        [[result.verdicts[number].hit(k) for k in terms.ks] for number in those], dtype=np.float64
    )
    plan = design.plan(those, hits[:, 0])
    draws = _drawn(plan, terms, lambda weights: 100 * (weights @ hits) / weights.sum(axis=1, keepdims=True))
    recall = {k: float(100.0 * hits[:, column].mean()) for column, k in enumerate(terms.ks)}
    intervals = {
        k: share_interval(recall[k], draws[:, column], units=plan.units, counted=len(those))
        for column, k in enumerate(terms.ks)
    }
    return recall, nested(intervals), {**plan.as_dict(), "times": terms.times, "seed": terms.seed}


def _precision_recall(found: Answers, terms: Terms, design: Design) -> PrecisionRecall | None:
    if not np.isfinite(found.scores).any():
        return None
    plan = design.plan(np.arange(len(found.scores)), found.right.astype(np.float64))
    draws = _drawn(plan, terms, found.area_and_full)
    curve = found.curve()
    return PrecisionRecall(
        curve.area,
        curve.recall_at_full_precision,
        curve.surest,
        percentile_interval(draws[:, 0]),
        percentile_interval(draws[:, 1]),
    )


def _distances(result: Result, terms: Terms, design: Design) -> Distances | None:
    counted = {number: one for number, one in enumerate(result.verdicts) if result.counts(one)}
    apart = {number: _apart(one) for number, one in counted.items()}
    placed = {number: far for number, far in apart.items() if not math.isnan(far)}
    if not placed or all(map(math.isinf, placed.values())):
        return None
    far = np.array(list(placed.values()))
    plan = design.plan(np.array(list(placed)), (far <= metres.WITHIN[-1]).astype(np.float64))
    draws = _drawn(
        plan,
        terms,
        lambda weights: np.column_stack([metres.medians(far, weights), metres.shares(far, weights)]),
    )
    within = metres.shares(far, np.ones((1, len(far))))[0]
    return Distances(
        known=len(far),
        median=float(np.median(far)),
        median_interval=percentile_interval(draws[:, 0]),
        within=dict(zip(metres.WITHIN, within.tolist(), strict=True)),
        within_intervals={
            limit: share_interval(float(share), draw, units=plan.units, counted=len(far))
            for limit, share, draw in zip(metres.WITHIN, within, draws[:, 1:].T, strict=True)
        },
    )


def _apart(one: Verdict) -> float:
    if one.metres is not None:
        return one.metres
    return math.inf if one.where is not None and not one.matches else math.nan


def _drawn(plan: Plan, terms: Terms, statistic: Statistic) -> Float64[np.ndarray, "draws figures"]:
    return np.concatenate([statistic(some) for some in plan.weights(seed=terms.seed, times=terms.times)])


def _said(rule: Unanswerable, own: Unanswerable) -> str:
    if rule == own:  # then it is part of what the protocol's name means
        return ""
    return f", unanswerable queries {'count as misses' if rule == 'miss' else 'left out'}"
