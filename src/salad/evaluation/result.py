"""What an evaluation found: figures with how sure they are, and what became of each query."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float64, Int64

from salad.datasets.benchmark import Benchmark, Unanswerable
from salad.datasets.compact_lists import PhotoList
from salad.datasets.folders import frame
from salad.errors import BenchmarkError
from salad.evaluation.bootstrap import Interval
from salad.evaluation.checked import count, exactly, interval, real
from salad.evaluation.leaks import Leak
from salad.evaluation.metrics import Answers, Distances, PrecisionRecall
from salad.files import read_json, write_whole
from salad.images.photo import Photo
from salad.tables import csv_line, whole, without_formulas

FORMAT = 1  # another where a file written before could no longer be read
COLUMNS = (
    *("query", "group", "positives", "first_right", "metres"),
    *("best_match", "best_score", "best_is_right", "lat", "lon"),
)
RULES: dict[str, Unanswerable] = {"drop": "drop", "miss": "miss"}  # a string read from JSON, by its type

Degrees: TypeAlias = tuple[float, float]
"""Latitude and longitude."""


@dataclass(frozen=True, eq=False)
class Ranked:
    """What was found for each query, best first.

    Attributes:
        rows: `[queries, k]` rows of references; -1 where there is no more.
        scores: `[queries, k]` their scores; None where there are none, as in ranked lists from outside.
    """

    rows: Int64[np.ndarray, "queries k"]
    scores: Float64[np.ndarray, "queries k"] | None = None


@dataclass(frozen=True, slots=True)
class QueryResult:
    """What became of one query.

    Attributes:
        query: Its photo, by its path below the folder of queries.
        positives: How many references are right for it.
        first_right: The rank of the first right one among `matches`, from 1; None where there is none among them.
        matches: Rows of the references found, best first.
        scores: Their scores, where there are any.
        right: The row of a right reference: the first found, or the first there is; None where none is right.
        metres: From the query to its best match; None where a position is not known, or nothing was found.
        where: Latitude and longitude of the query, where known.
        group: The drive, place or panorama it belongs to, where known.
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

    @classmethod
    def from_dict(cls, read: dict[str, Any]) -> QueryResult:
        """What `dataclasses.asdict` made of one, and JSON of that."""
        if read.keys() != {field.name for field in fields(cls)}:
            raise ValueError(f"verdict of {sorted(read)}")
        first_right, scores, right = read["first_right"], read["scores"], read["right"]
        return cls(
            query=exactly(str, read["query"]),
            positives=count(read["positives"]),
            first_right=None if first_right is None else count(first_right, least=1),
            matches=tuple(map(count, read["matches"])),
            scores=None if scores is None else tuple(map(real, scores)),
            right=None if right is None else count(right),
            metres=None if read["metres"] is None else real(read["metres"]),
            where=_where(read["where"]),
            group=None if read["group"] is None else exactly(str, read["group"]),
        )


@dataclass(frozen=True, slots=True)
class Reference:
    """A reference that a verdict names: its path below the folder of references, and where it is, if known."""

    name: str
    where: Degrees | None = None

    @classmethod
    def of(cls, photo: Photo, folder: str) -> Reference:
        """A photo of the references, named by its path below a folder."""
        return cls(below(photo.path, folder), (photo.where.lat, photo.where.lon) if photo.where else None)


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
        precision_recall: The curve in short; None where there are no scores.
        distances: Metres; None where positions are not known.
        leaks: Photos that are in both sides; None where nobody looked.
        per_query: What became of each query, in the benchmark's order.
        known: The references that verdicts name, by row.
        folders: The folders of references and of queries that names are below.
        digests: Of the references' names and of what is right, to tell whether two results are of one set.
        from_file: Whether it was read from a file: its folders are then what somebody wrote there, and nothing is
            opened below them.
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
    from_file: bool = field(default=False, compare=False)

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
            "intervals": {str(k): list(interval) for k, interval in self.intervals.items()},
            "drawn": dict(self.drawn),
            "precision_recall": None if curve is None else curve.as_dict(),
            "metres": None if distances is None else distances.as_dict(),
            "leaks": None if self.leaks is None else [asdict(leak) for leak in self.leaks],
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, read: dict[str, Any]) -> Result:
        """What `write_result` wrote.

        Raises:
            KeyError: If something is missing.
            TypeError: If something is of another type.
            ValueError: If parts do not fit together.
        """
        names = ("benchmark", "protocol", "model", "fingerprint")
        leaks, curve, metres = read["leaks"], read["precision_recall"], read["metres"]
        references, queries = (exactly(str, folder) for folder in read["folders"])
        names_digest, rows_digest = (exactly(str, digest) for digest in read["digests"])
        result = cls(
            **{name: exactly(str, read[name]) for name in names},
            queries=count(read["queries"]),
            references=count(read["references"]),
            unanswerable=count(read["unanswerable"]),
            recall={count(whole(k), least=1): real(percent) for k, percent in read["recall"].items()},
            seconds=real(read["seconds"]),
            notes=tuple(exactly(str, note) for note in read["notes"]),
            unanswerable_rule=RULES[exactly(str, read["unanswerable_rule"])],
            intervals={whole(k): interval(ends) for k, ends in read["intervals"].items()},
            drawn=_drawn(read["drawn"]),
            precision_recall=None if curve is None else PrecisionRecall.from_dict(curve),
            distances=None if metres is None else Distances.from_dict(metres),
            leaks=None if leaks is None else tuple(map(_leak, leaks)),
            per_query=tuple(map(QueryResult.from_dict, read["verdicts"])),
            known={
                whole(row): Reference(exactly(str, name), _where(where)) for row, (name, where) in read["known"].items()
            },
            folders=(references, queries),
            digests=(names_digest, rows_digest),
            from_file=True,
        )
        if len(result.per_query) != result.queries:
            raise ValueError(f"{result.queries} queries, {len(result.per_query)} verdicts")
        # Every figure is shown with how sure it is.
        if bare := result.recall.keys() - result.intervals.keys():
            raise ValueError(f"R@{min(bare)} has no interval")
        # A report looks up every match: one without a name would end it halfway.
        missing = {row for one in result.per_query for row in one.matches} - result.known.keys()
        if missing:
            raise ValueError(f"reference {min(missing)} has no name")
        return result

    def counts(self, one: QueryResult) -> bool:
        """Whether shares are of this query too, by the protocol's rule."""
        return one.positives > 0 or self.unanswerable_rule == "miss"

    def answers(self) -> Answers | None:
        """What the precision-recall curve is of; None where there are no scores."""
        return Answers.of(self.per_query)


def write_result(result: Result, path: Path) -> None:
    """Write a result as JSON with every figure and every query, whole or not at all; what stood there is replaced.

    Raises:
        BenchmarkError: If it cannot be written.
    """
    written = {
        "format": FORMAT,
        **result.as_dict(),
        "folders": list(result.folders),
        "digests": list(result.digests),
        "known": {str(row): [one.name, one.where] for row, one in result.known.items()},
        "verdicts": [asdict(one) for one in result.per_query],  # what the first release called them
    }
    # NaN and Infinity are no JSON, whatever Python's reader says: other readers refuse the file.
    text = json.dumps(written, allow_nan=False, separators=(",", ":"))
    write_file(path, text.encode("utf-8"))


def read_result(path: Path) -> Result:
    """Read a result that `write_result` wrote.

    Raises:
        BenchmarkError: If it cannot be read, or is not one.
    """
    try:
        read = read_json(path)
    except OSError as error:
        raise BenchmarkError(f"{path} cannot be read ({error.strerror}): check the name") from error
    except ValueError as error:
        raise BenchmarkError(f"{path} is no JSON: write it with salad evaluate --save") from error
    if not isinstance(read, dict) or "verdicts" not in read:
        raise BenchmarkError(f"{path} does not say what became of each query: write it with salad evaluate --save")
    if read.get("format") != FORMAT:
        raise BenchmarkError(
            f"{path} is of format {read.get('format')!r}, not {FORMAT}: read it with the salad that wrote it"
        )
    try:
        return Result.from_dict(read)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BenchmarkError(f"{path} is damaged ({error}): write it anew") from error


def as_csv(result: Result) -> str:
    """One line a query; what is not known leaves its field empty."""
    lines = [csv_line(COLUMNS)]
    for one in result.per_query:
        best = PurePosixPath(result.known[one.matches[0]].name) if one.matches else ""
        score = f"{one.scores[0]:.6f}" if one.scores else ""
        near = "" if one.metres is None else f"{one.metres:.2f}"
        lat, lon = ("", "") if one.where is None else (f"{degrees:.7f}" for degrees in one.where)
        known = [PurePosixPath(one.query), one.group or "", one.positives, one.first_right or "", near]
        lines.append(csv_line(without_formulas([*known, best, score, int(one.hit(1)), lat, lon])))
    return "".join(lines)


def write_csv(result: Result, path: Path) -> None:
    """Write `as_csv`, whole or not at all.

    Raises:
        BenchmarkError: If it cannot be written.
    """
    # A name may hold bytes that are no UTF-8: they are written as they are.
    write_file(path, as_csv(result).encode("utf-8", "surrogateescape"))


def write_file(path: Path, content: bytes) -> None:
    """Write what an evaluation leaves behind, whole or not at all.

    Raises:
        BenchmarkError: If it cannot be written.
    """
    try:
        write_whole(path, content)
    except OSError as error:
        raise BenchmarkError(
            f"{path} cannot be written ({error.strerror}): name a file in a folder that is there"
        ) from error


def _where(read: list[float] | None) -> Degrees | None:
    if read is None:
        return None
    lat, lon = read
    return real(lat), real(lon)


def _drawn(read: Any) -> dict[str, Any]:
    """How queries were drawn again, as a page tells it; nothing where they were not."""
    told: dict[str, Any] = exactly(dict, read)
    if told:
        exactly(str, told["by"])
        for name in ("units", "length", "times", "seed"):
            count(told[name])
    return told


def _leak(read: Any) -> Leak:
    leak = Leak(**exactly(dict, read))
    for number in (leak.query, leak.reference):
        count(number)
    for text in (leak.query_path, leak.reference_path, leak.kind):
        exactly(str, text)
    real(leak.difference)
    return leak


# Names that outlive the data set's folder: a result says of each photo where it lies below its side's folder, so that
# it can be laid beside a copy of the set on another machine.


def folder_of(photos: Sequence[Photo]) -> str:
    """The folder that all photos lie below, in full; empty where they lie on several drives of a system."""
    if isinstance(photos, PhotoList):
        return os.path.abspath(photos.folder)  # noqa: PTH100  # links are left as they are named
    try:
        return os.path.commonpath({os.path.abspath(photo.path.parent) for photo in photos})  # noqa: PTH100  # the same
    except ValueError:  # two drives of Windows have no folder in common
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


def digests_of(benchmark: Benchmark, folder: str) -> tuple[str, str]:
    """Tell one set from another: by its references' paths below their folder, and by what is right."""
    photos = benchmark.references
    # A list of millions of photos has its names at hand, and would have to make each photo.
    named = photos.names if isinstance(photos, PhotoList) else (below(each.path, folder) for each in photos)
    names, right = hashlib.blake2b(digest_size=16), hashlib.blake2b(digest_size=16)
    for name in named:
        names.update(name.encode("utf-8", "surrogateescape") + b"\0")
    for rows in benchmark.positives:
        right.update(np.append(np.asarray(rows, dtype="<i8"), -1).tobytes())  # -1 ends a query's rows
    return names.hexdigest(), right.hexdigest()
