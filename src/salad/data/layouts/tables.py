"""Columns out of a CSV table, each cell still a text; every fault names the table and its line."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from salad.errors import BenchmarkError

_TRUTHS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False, "": False}


def columns(table: Path, names: Sequence[str]) -> dict[str, list[str]]:
    """The named columns; others, such as an unnamed first one, are left aside.

    Raises:
        BenchmarkError: the table cannot be read, lacks a column, or a line is too short.
    """
    found: dict[str, list[str]] = {name: [] for name in names}
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.DictReader(file, strict=True)
            missing = [name for name in names if name not in (lines.fieldnames or ())]
            if missing:
                raise BenchmarkError(f"{table} lacks the column {missing[0]!r}: fetch the table again")
            for line in lines:
                for name, cells in found.items():
                    if line[name] is None:
                        raise BenchmarkError(f"{table}, line {lines.line_num}: it ends before {name!r}")
                    cells.append(line[name].strip())
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BenchmarkError(f"the table {table} cannot be read ({error}): fetch it again") from error
    return found


def numbers(table: Path, name: str, cells: Sequence[str]) -> Float64[np.ndarray, " n"]:
    """A column of finite numbers.

    Raises:
        BenchmarkError: a cell is none; named by its row.
    """
    read = np.array([_number(cell) for cell in cells], dtype=np.float64)
    wrong = np.flatnonzero(~np.isfinite(read))
    if wrong.size:
        row = int(wrong[0])
        raise BenchmarkError(
            f"{table}, row {row + 1}: {name} {cells[row][:40]!r} is no number: fetch it again"
        )
    return read


def truths(table: Path, name: str, cells: Sequence[str]) -> Bool[np.ndarray, " n"]:
    """A column of `True` and `False`.

    Raises:
        BenchmarkError: a cell is neither; named by its row.
    """
    for row, cell in enumerate(cells, 1):
        if cell.lower() not in _TRUTHS:
            raise BenchmarkError(f"{table}, row {row}: {name} {cell[:40]!r} is neither True nor False")
    return np.array([_TRUTHS[cell.lower()] for cell in cells], dtype=np.bool_)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
