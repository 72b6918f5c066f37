"""A result in a file: JSON with every figure and every verdict, read back as it was written."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from salad.csvtext import csv_line
from salad.errors import BenchmarkError
from salad.evaluation.intervals import Interval
from salad.evaluation.leaks import Leak
from salad.evaluation.result import Distances, PrecisionRecall, Reference, Result, Verdict
from salad.wholefile import write_whole

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
        "verdicts": [asdict(one) for one in result.verdicts],
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
    for one in result.verdicts:
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
        verdicts=tuple(_verdict(one) for one in told["verdicts"]),
        known={
            int(row): Reference(_of(str, name), _where(where)) for row, (name, where) in told["known"].items()
        },
        folders=_two(told["folders"]),
        digests=_two(told["digests"]),
    )
    if len(result.verdicts) != result.queries:
        raise ValueError(f"{result.queries} queries, {len(result.verdicts)} verdicts")
    missing = {row for one in result.verdicts for row in one.matches} - result.known.keys()
    if missing:
        raise ValueError(f"reference {min(missing)} has no name")
    return result


def _verdict(told: dict[str, Any]) -> Verdict:
    if told.keys() != {field.name for field in fields(Verdict)}:
        raise ValueError(f"verdict of {sorted(told)}")
    scores = told["scores"]
    return Verdict(
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
