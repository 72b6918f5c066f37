"""From a benchmark and whatever answers it to a result: a model, or descriptors or ranked lists from outside."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from salad.data.benchmark import Benchmark, Unanswerable
from salad.evaluation.cached import Cache
from salad.evaluation.describing import Described
from salad.evaluation.judging import Terms, judged
from salad.evaluation.leaks import find_leaks
from salad.evaluation.outside import depth, read_descriptors, read_rankings
from salad.evaluation.ranking import nearest
from salad.evaluation.recall import KS
from salad.evaluation.result import Result
from salad.place.locating import calibration_of

if TYPE_CHECKING:
    from salad.model.describer import Describes

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
            all references have in common (`salad.index.centring`).
        progress: Told how many photos are described, and of how many.

    Raises:
        BenchmarkError: A photo cannot be read (a figure with holes is no figure), no query has an answer, or the cache
            cannot be written.
        ModelError: The model gives descriptors of another shape than it says, or numbers that are not finite.
    """
    terms = Terms(ks, unanswerable, seed)
    terms.check(benchmark)
    began = time.perf_counter()
    described = Described(model, batch_size=batch_size)
    source = described if cache is None else Cache(cache, described)
    references, queries = source.sides(benchmark.references, benchmark.queries, progress=progress)
    own = calibration_of(model).centred
    ranked = nearest(queries, references, k=max(ks), centred=own and not plain)
    return judged(
        benchmark,
        ranked,
        terms,
        model=f"{model.name}, plain" if own and plain else model.name,
        notes=(CENTRED,) if own and not plain else (),
        fingerprint=model.fingerprint,
        seconds=time.perf_counter() - began,
    )


def evaluate_descriptors(
    benchmark: Benchmark, references: Path, queries: Path, *, name: str, terms: Terms | None = None
) -> Result:
    """Judge descriptors that somebody else made: two `.npy` files, rows in the order of the benchmark's photos.

    Args:
        benchmark: the set and its ground truth.
        references: descriptors of the references.
        queries: descriptors of the queries.
        name: what to call the method.
        terms: on what terms, where not the usual ones.

    Raises:
        BenchmarkError: a file cannot be read or does not fit the set, or no query has an answer.
    """
    terms = terms or Terms()
    terms.check(benchmark)
    began = time.perf_counter()
    known, asked, notes = read_descriptors(benchmark, references, queries)
    ranked = nearest(asked, known, k=max(terms.ks))
    seconds = time.perf_counter() - began
    return judged(benchmark, ranked, terms, model=name, seconds=seconds, notes=notes)


def evaluate_rankings(
    benchmark: Benchmark, rankings: Path, *, name: str, terms: Terms | None = None
) -> Result:
    """Judge ranked lists that somebody else made, in the form of the MSLS challenge.

    Args:
        benchmark: the set and its ground truth.
        rankings: the file.
        name: what to call the method.
        terms: on what terms, where not the usual ones; a k beyond the longest list is left out.

    Raises:
        BenchmarkError: the file cannot be read or does not fit the set, or no query has an answer.
    """
    terms = terms or Terms()
    terms.check(benchmark)
    began = time.perf_counter()
    ranked, notes = read_rankings(benchmark, rankings)
    ks = depth(ranked, len(benchmark.references), terms.ks)
    seconds = time.perf_counter() - began
    return judged(benchmark, ranked, replace(terms, ks=ks), model=name, seconds=seconds, notes=notes)


def with_leaks(result: Result, benchmark: Benchmark) -> Result:
    """The result with the photos that are in both sides.

    Raises:
        BenchmarkError: a photo cannot be read.
    """
    matches = [one.matches for one in result.verdicts]
    scores = [one.scores for one in result.verdicts if one.scores is not None]
    found = find_leaks(
        benchmark.queries,
        benchmark.references,
        matches=matches,
        scores=scores if len(scores) == len(matches) and _are_cosines(scores) else None,
    )
    return replace(result, leaks=found)


def _are_cosines(scores: Sequence[Sequence[float]]) -> bool:
    return all(abs(score) <= 1.01 for told in scores for score in told)
