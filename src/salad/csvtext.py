"""Lines of comma-separated values, whatever the values hold."""

from __future__ import annotations

import csv
from collections.abc import Iterable


class _Back:
    def write(self, line: str) -> str:
        return line


def csv_line(values: Iterable[object]) -> str:
    """One line with its end; None leaves its field empty. What the values hold comes back from any reader of CSV.

    Raises:
        TypeError: `values` cannot be gone through.
    """
    # Older Pythons put quotes around an end of line only where it holds a character of their own line's end.
    end = "\r\n"
    line: str = csv.writer(_Back(), lineterminator=end).writerow(values)
    return line.removesuffix(end) + "\n"
