"""What an evaluation found: figures with how sure they are, and what became of each query."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float64, Int64

from salad.datasets.benchmark import Benchmark, Unanswerable
from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import frame
from salad.errors import BenchmarkError
from salad.evaluation import metrics
from salad.evaluation.bootstrap import Interval
from salad.evaluation.leaks import Leak
from salad.evaluation.metrics import Answers, first_hits
from salad.files import write_whole
from salad.images.photo import Photo
from salad.tables import csv_line

Degrees: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class QueryResult:
    """What became of one query.

    Attributes:
        query: its photo, by its path below the folder of queries.
        positives: how many references are right for it.
        first_right: the rank of the first right one among `matches`, from 1; None where there is none among them.
        matches: rows of the references found, best first.
        scores: their scores, where somebody told them.
        right: the row of a right reference: the first found, or the first there is; None where none is right.
        metres: from the query to its best match; None where a position is not known, or nothing was found.
        where: latitude and longitude of the query, where known.
        group: the drive, place or panorama it belongs to, where known.
    """

    query: str
    positives: int
    first_right: int | None
    matches: tuple[int, ...]
    scores: tuple[float, ...] | None = None
    right: int | None = None
    metres: float | None = None
    where: Degrees | None = None
    group: str | None = None

    def hit(self, k: int) -> bool:
        """Whether a right reference is among the first k."""
        return self.first_right is not None and self.first_right <= k


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference that a verdict names: its path below the folder of references, and where it is, if known."""

    name: str
    where: Degrees | None = None


@dataclass(frozen=True, slots=True)
class PrecisionRecall:
    """The curve over the threshold on the best score, in three numbers; all in percent but the threshold.

    Attributes:
        area: below the curve (average precision).
        recall_at_full_precision: the most recall with no wrong answer.
        threshold: the least score believed there; None where the surest answer of all is wrong.
        area_interval: how sure `area` is.
        full_interval: how sure `recall_at_full_precision` is.
    """

    area: float
    recall_at_full_precision: float
    threshold: float | None
    area_interval: Interval
    full_interval: Interval

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "area": self.area,
            "area_interval": self.area_interval.as_list(),
            "recall_at_full_precision": self.recall_at_full_precision,
            "recall_at_full_precision_interval": self.full_interval.as_list(),
            "threshold": self.threshold,
        }


@dataclass(frozen=True, slots=True)
class Distances:
    """How far best matches stand from their queries.

    Attributes:
        known: how many of the queries that count have a position, as their best matches have.
        median: of these, in metres; infinite where most of them have no match at all.
        median_interval: how sure that is.
        within: percent within so many metres.
        within_intervals: how sure each is.
    """

    known: int
    median: float
    median_interval: Interval
    within: dict[int, float]
    within_intervals: dict[int, Interval]

    def as_dict(self) -> dict[str, Any]:
        """The JSON form; what is infinite is null."""
        return {
            "known": self.known,
            "median": _finite(self.median),
            "median_interval": [_finite(end) for end in self.median_interval.as_list()],
            "within": {str(metres): share for metres, share in self.within.items()},
            "within_intervals": {str(m): interval.as_list() for m, interval in self.within_intervals.items()},
        }


@dataclass(frozen=True)
class Result:
    """What an evaluation found.

    Attributes:
        benchmark: The set's name.
        protocol: The rule that said what was right; never show a figure without it.
        queries: How many queries there were, the unanswerable ones included.
        references: How many references there were.
        unanswerable: How many queries had no right reference.
        recall: Recall in percent for each k.
        model: The model's name.
        seconds: Time for describing both sides and ranking.
        notes: Sentences a reader of the figures should see.
        fingerprint: The model's; empty where descriptors or rankings came from outside.
        unanswerable_rule: Whether unanswerable queries were left out of shares or counted as misses.
        intervals: Where the truth of each recall lies 95 times in 100.
        drawn: What was drawn again together for that: `by`, `units`, `length`, `level`, `times`, `seed`.
        precision_recall: The curve in short; None where nobody told scores.
        distances: Metres; None where positions are not known.
        leaks: Photos that are in both sides; None where nobody looked.
        per_query: What became of each query, in the benchmark's order.
        known: The references that verdicts name, by row.
        folders: The folders of references and of queries that names are below.
        digests: Of the references' names and of what is right, to tell whether two results are of one set.
    """

    benchmark: str
    protocol: str
    queries: int
    references: int
    unanswerable: int
    recall: dict[int, float]
    model: str
    seconds: float
    notes: tuple[str, ...] = ()
    fingerprint: str = ""
    unanswerable_rule: Unanswerable = "drop"
    intervals: dict[int, Interval] = field(default_factory=dict)
    drawn: Mapping[str, Any] = field(default_factory=dict)
    precision_recall: PrecisionRecall | None = None
    distances: Distances | None = None
    leaks: tuple[Leak, ...] | None = None
    per_query: tuple[QueryResult, ...] = ()
    known: Mapping[int, Reference] = field(default_factory=dict)
    folders: tuple[str, str] = ("", "")
    digests: tuple[str, str] = ("", "")

    def as_dict(self) -> dict[str, Any]:
        """Give the JSON form that `salad evaluate --format json` prints: every figure, but no single query."""
        curve, distances = self.precision_recall, self.distances
        return {
            "protocol": self.protocol,
            "queries": self.queries,
            "references": self.references,
            "unanswerable": self.unanswerable,
            "recall": {str(k): percent for k, percent in self.recall.items()},
            "model": self.model,
            "seconds": self.seconds,
            "benchmark": self.benchmark,
            "unanswerable_rule": self.unanswerable_rule,
            "fingerprint": self.fingerprint,
            "intervals": {str(k): interval.as_list() for k, interval in self.intervals.items()},
            "drawn": dict(self.drawn),
            "precision_recall": None if curve is None else curve.as_dict(),
            "metres": None if distances is None else distances.as_dict(),
            "leaks": None if self.leaks is None else [leak.as_dict() for leak in self.leaks],
            "notes": list(self.notes),
        }

    def counts(self, one: QueryResult) -> bool:
        """Whether shares are of this query too, by the protocol's rule."""
        return one.positives > 0 or self.unanswerable_rule == "miss"

    def answers(self) -> Answers | None:
        """What the precision-recall curve is of; None where nobody told scores."""
        return answers(self.per_query)


def answers(verdicts: tuple[QueryResult, ...]) -> Answers | None:
    """Best scores and whether the best matches are right; None where a verdict has no scores."""
    scores = [one.scores for one in verdicts]
    if not scores or any(told is None for told in scores):
        return None
    best: Float64[np.ndarray, " queries"] = np.array([told[0] if told else -math.inf for told in scores])
    right: Bool[np.ndarray, " queries"] = np.array([one.hit(1) for one in verdicts])
    return Answers(best, right, np.array([one.positives > 0 for one in verdicts]))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


# --- A result in a file: JSON with every figure and every verdict, read back as it was written ---


FORMAT = 1
COLUMNS = (
    *("query", "group", "positives", "first_right", "metres"),
    *("best_match", "best_score", "best_is_right", "lat", "lon"),
)


def write_result(result: Result, path: Path) -> None:
    """Write a result, whole or not at all; what stood there is replaced.

    Raises:
        BenchmarkError: it cannot be written.
    """
    told = {
        "format": FORMAT,
        **result.as_dict(),
        "folders": list(result.folders),
        "digests": list(result.digests),
        "known": {str(row): [one.name, one.where] for row, one in result.known.items()},
        "verdicts": [asdict(one) for one in result.per_query],
    }
    text = json.dumps(told, allow_nan=False, separators=(",", ":"))
    _write(path, text.encode("utf-8"))


def read_result(path: Path) -> Result:
    """Read a result that `write_result` wrote.

    Raises:
        BenchmarkError: it cannot be read, or is not one.
    """
    try:
        told = json.loads(path.read_bytes())
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read ({error.strerror}): check the name") from error
    except (ValueError, RecursionError) as error:
        raise BenchmarkError(f"{path} is no JSON: write it with salad evaluate --save") from error
    if not isinstance(told, dict) or "verdicts" not in told:
        raise BenchmarkError(
            f"{path} does not say what became of each query: write it with salad evaluate --save"
        )
    if told.get("format") != FORMAT:
        raise BenchmarkError(
            f"{path} is of format {told.get('format')!r}, not {FORMAT}: read it with the salad that wrote it"
        )
    try:
        return _result(told)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BenchmarkError(f"{path} is damaged ({error!r}): write it anew") from error


def as_csv(result: Result) -> str:
    """One line a query; what is not known leaves its field empty."""
    lines = [csv_line(COLUMNS)]
    for one in result.per_query:
        best = result.known[one.matches[0]].name if one.matches else ""
        score = f"{one.scores[0]:.6f}" if one.scores else ""
        near = "" if one.metres is None else f"{one.metres:.2f}"
        lat, lon = ("", "") if one.where is None else (f"{degrees:.7f}" for degrees in one.where)
        told = [one.query, one.group or "", one.positives, one.first_right or "", near]
        lines.append(csv_line([*told, best, score, int(one.hit(1)), lat, lon]))
    return "".join(lines)


def write_csv(result: Result, path: Path) -> None:
    """Write `as_csv`, whole or not at all.

    Raises:
        BenchmarkError: it cannot be written.
    """
    _write(path, as_csv(result).encode("utf-8", "surrogateescape"))


def _write(path: Path, content: bytes) -> None:
    try:
        write_whole(path, content)
    except OSError as error:
        raise BenchmarkError(
            f"{path} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error


# --- reading -------------------------------------------------------------------------------


def _result(told: dict[str, Any]) -> Result:
    names = ("benchmark", "protocol", "model", "fingerprint")
    counts = ("queries", "references", "unanswerable")
    leaks, curve, distances = told["leaks"], told["precision_recall"], told["metres"]
    result = Result(
        **{name: _of(str, told[name]) for name in names},
        **{name: _of(int, told[name]) for name in counts},
        recall={int(k): float(percent) for k, percent in told["recall"].items()},
        seconds=float(told["seconds"]),
        notes=tuple(_of(str, note) for note in told["notes"]),
        unanswerable_rule={"drop": "drop", "miss": "miss"}[told["unanswerable_rule"]],  # type: ignore[arg-type]  # values are str
        intervals={int(k): _interval(ends) for k, ends in told["intervals"].items()},
        drawn=_of(dict, told["drawn"]),
        precision_recall=None if curve is None else _curve(curve),
        distances=None if distances is None else _distances(distances),
        leaks=None if leaks is None else tuple(Leak(**leak) for leak in leaks),
        per_query=tuple(_verdict(one) for one in told["verdicts"]),
        known={
            int(row): Reference(_of(str, name), _where(where)) for row, (name, where) in told["known"].items()
        },
        folders=_two(told["folders"]),
        digests=_two(told["digests"]),
    )
    if len(result.per_query) != result.queries:
        raise ValueError(f"{result.queries} queries, {len(result.per_query)} verdicts")
    missing = {row for one in result.per_query for row in one.matches} - result.known.keys()
    if missing:
        raise ValueError(f"reference {min(missing)} has no name")
    return result


def _verdict(told: dict[str, Any]) -> QueryResult:
    if told.keys() != {field.name for field in fields(QueryResult)}:
        raise ValueError(f"verdict of {sorted(told)}")
    scores = told["scores"]
    return QueryResult(
        query=_of(str, told["query"]),
        positives=_of(int, told["positives"]),
        first_right=None if told["first_right"] is None else _of(int, told["first_right"]),
        matches=tuple(_of(int, row) for row in told["matches"]),
        scores=None if scores is None else tuple(map(float, scores)),
        right=None if told["right"] is None else _of(int, told["right"]),
        metres=None if told["metres"] is None else float(told["metres"]),
        where=_where(told["where"]),
        group=None if told["group"] is None else _of(str, told["group"]),
    )


def _curve(told: dict[str, Any]) -> PrecisionRecall:
    threshold = told["threshold"]
    return PrecisionRecall(
        float(told["area"]),
        float(told["recall_at_full_precision"]),
        None if threshold is None else float(threshold),
        _interval(told["area_interval"]),
        _interval(told["recall_at_full_precision_interval"]),
    )


def _distances(told: dict[str, Any]) -> Distances:
    return Distances(
        known=_of(int, told["known"]),
        median=_metres(told["median"]),
        median_interval=Interval(*map(_metres, told["median_interval"])),
        within={int(metres): float(share) for metres, share in told["within"].items()},
        within_intervals={int(metres): _interval(ends) for metres, ends in told["within_intervals"].items()},
    )


def _metres(told: float | None) -> float:
    return float("inf") if told is None else float(told)


def _interval(ends: list[float]) -> Interval:
    low, high = ends
    return Interval(float(low), float(high))


def _where(told: list[float] | None) -> tuple[float, float] | None:
    if told is None:
        return None
    lat, lon = told
    return float(lat), float(lon)


def _two(told: list[str]) -> tuple[str, str]:
    one, other = told
    return _of(str, one), _of(str, other)


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return value


# --- What became of each query, in words that outlive the data set: names below a folder, rows, metres ---


@dataclass(frozen=True, eq=False)
class Ranked:
    """What was found for each query, best first.

    Attributes:
        rows: `[queries, k]` rows of references; -1 where there is no more.
        scores: `[queries, k]` their scores; None where nobody told them.
    """

    rows: Int64[np.ndarray, "queries k"]
    scores: Float64[np.ndarray, "queries k"] | None = None


def verdicts_of(benchmark: Benchmark, ranked: Ranked, folder: str) -> tuple[QueryResult, ...]:
    """What became of each query, named by its path below a folder."""
    places = first_hits(ranked.rows, benchmark.positives)
    best = ranked.rows[:, 0] if ranked.rows.shape[1] else np.full(len(ranked.rows), -1)
    apart = metrics.distance_errors(benchmark.queries, benchmark.references, best)
    return tuple(
        _query_verdict(
            benchmark,
            ranked,
            number,
            below(benchmark.queries[number].path, folder),
            float(places[number]),
            float(apart[number]),
        )
        for number in range(len(ranked.rows))
    )


def _query_verdict(
    benchmark: Benchmark, ranked: Ranked, number: int, name: str, place: float, apart: float
) -> QueryResult:
    found = ranked.rows[number] >= 0
    rows = ranked.rows[number][found].tolist()
    right = benchmark.positives[number]
    first = None if math.isinf(place) else int(place)
    where = benchmark.queries[number].where
    return QueryResult(
        query=name,
        positives=len(right),
        first_right=None if first is None else first + 1,
        matches=tuple(rows),
        scores=None if ranked.scores is None else tuple(ranked.scores[number][found].tolist()),
        right=int(ranked.rows[number][first]) if first is not None else int(right[0]) if len(right) else None,
        metres=apart if math.isfinite(apart) else None,
        where=None if where is None else (where.lat, where.lon),
        group=benchmark.groups[number] if benchmark.groups is not None else None,
    )


def known(benchmark: Benchmark, verdicts: Sequence[QueryResult], folder: str) -> dict[int, Reference]:
    """The references that verdicts name, by row: their paths below a folder, and where they are."""
    rows = {row for one in verdicts for row in one.matches}
    rows |= {one.right for one in verdicts if one.right is not None}
    photos = {row: benchmark.references[row] for row in sorted(rows)}
    return {
        row: Reference(
            below(photo.path, folder), None if photo.where is None else (photo.where.lat, photo.where.lon)
        )
        for row, photo in photos.items()
    }


def folder_of(photos: Sequence[Photo]) -> str:
    """The folder that all photos lie below, in full; empty where they lie on several drives of a system."""
    if isinstance(photos, PhotoList):
        return os.path.abspath(photos.folder)  # noqa: PTH100  # links are left as they are named
    try:
        return os.path.commonpath({os.path.abspath(photo.path.parent) for photo in photos})  # noqa: PTH100  # the same
    except ValueError:
        return ""


def below(path: Path, folder: str) -> str:
    """A photo's path below a folder, with `/`; in full where it does not lie there."""
    full = os.path.abspath(path)  # noqa: PTH100  # the same
    inside = folder.rstrip(os.sep) + os.sep
    return full.removeprefix(inside).replace(os.sep, "/") if folder else full


def along(paths: Sequence[Path]) -> tuple[int, ...]:
    """Each photo's place along a drive: the last number in its name, else as it stands."""
    try:
        return tuple(frame(path.name) for path in paths)
    except BenchmarkError:  # a name without a number
        return tuple(range(len(paths)))


def names_digest(photos: Sequence[Photo], folder: str) -> str:
    """Tells one sequence of photos from another by their paths below a folder."""
    digest = hashlib.blake2b(digest_size=16)
    names = photos.names if isinstance(photos, PhotoList) else (below(each.path, folder) for each in photos)
    for name in names:
        digest.update(name.encode("utf-8", "surrogateescape") + b"\0")
    return digest.hexdigest()


def rows_digest(positives: Sequence[Int64[np.ndarray, " n"]]) -> str:
    """Tells one ground truth from another."""
    digest = hashlib.blake2b(digest_size=16)
    for rows in positives:
        digest.update(np.append(np.asarray(rows, dtype="<i8"), -1).tobytes())
    return digest.hexdigest()
