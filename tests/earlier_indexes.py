"""Indexes as earlier versions wrote them, made from today's; and rows of the table written as today's are."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

from salad.index.facts import COLUMNS, facts_sum


def as_format_1(folder: Path, *, sums: bool = True) -> None:
    """Bring an index that nobody has open to format 1, as salad wrote until 2026-11; without `sums`, as 0.1.0 did."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        for column in ("source", "facts", *([] if sums else ["sum"])):
            db.execute(f"ALTER TABLE photos DROP COLUMN {column}")
        for column in ("dim", "fingerprint"):
            db.execute(f"ALTER TABLE committed DROP COLUMN {column}")
    header = json.loads((folder / "index.json").read_bytes())
    (folder / "index.json").write_text(json.dumps({**header, "format_version": 1}, indent=2) + "\n")


def change_row(folder: Path, row: int, *, checksum: bool, **values: object) -> None:
    """Change what the table says of a photo: with its checksum, as whoever means it, or without, as a damaged disk."""
    with closing(sqlite3.connect(folder / "photos.sqlite")) as db, db:
        for column, value in values.items():
            db.execute(f"UPDATE photos SET {column} = ? WHERE row = ?", (value, row))
        if checksum:
            ((_, *told, _, _),) = db.execute(f"SELECT {COLUMNS} FROM photos WHERE row = ?", (row,)).fetchall()
            db.execute("UPDATE photos SET facts = ? WHERE row = ?", (facts_sum(told), row))
