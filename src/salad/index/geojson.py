"""GeoJSON as a list of photos has it, a feature at a time: a file of a million is never held, and no part of it grows.

A reader of whole files would take twenty times their length for some; and what is nested without end would end it.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from salad.files import json_text, open_file

MOST = 1 << 20
"""Letters of one feature, or of whatever else stands beside the features."""
_AHEAD = 1 << 16  # letters read at once, so that no number is cut in two and taken for its first half
_BLANKS = re.compile(r"[ \t\r\n]*")

Record = Mapping[str, Any]


def read_features(path: Path) -> Iterator[Any]:
    """What a GeoJSON file lists as its features, one after another, whatever they are.

    Raises:
        OSError: If the file cannot be read, or is none.
        ValueError: If it is no JSON, holds no list of features, or a part of it is too large.
    """
    with open_file(path) as raw, io.TextIOWrapper(raw, encoding="utf-8-sig") as file:
        text, seen = _Text(file), False
        text.take("{")
        while True:
            name = text.value()
            text.take(":")
            if name != "features":
                text.value()
            elif seen:
                raise ValueError("it lists its features twice")
            else:
                seen = True
                yield from text.items()
            if text.take(",}") == "}":
                break
        if not seen:
            raise ValueError("it lists no features")
        if text.rest():
            raise ValueError("something stands behind its end")


class _Text:
    """JSON that is read in parts."""

    def __init__(self, file: TextIO) -> None:
        self._file, self._held, self._place = file, "", 0
        self._decode = json.JSONDecoder().raw_decode

    def items(self) -> Iterator[Any]:
        """The values of a list that begins here."""
        self.take("[")
        if self._next() == "]":
            self.take("]")
            return
        while True:
            yield self.value()
            if self.take(",]") == "]":
                return

    def value(self) -> Any:
        """The value that begins here."""
        self._next()
        wanted = _AHEAD
        while True:
            whole = not self._fill(wanted)
            try:
                found, self._place = self._decode(self._held, self._place)
            except RecursionError as error:
                raise ValueError("it is nested too deeply") from error
            except ValueError:
                if whole:  # there is no more to come
                    raise
            else:
                return found
            if wanted >= MOST:
                raise ValueError(f"a part of it is longer than {MOST:,} letters, or no JSON")
            wanted *= 4

    def take(self, some: str) -> str:
        """The next letter, which must be one of these."""
        found = self._next()
        if not found or found not in some:
            raise ValueError(f"{' or '.join(some)} should stand where {found or 'its end'} does")
        self._place += 1
        return found

    def rest(self) -> bool:
        """Whether anything follows."""
        return bool(self._next())

    def _next(self) -> str:
        """The next letter that is no blank, which stays; nothing at the end."""
        while True:
            self._place = _BLANKS.match(self._held, self._place).end()  # type: ignore[union-attr]  # none is enough
            if self._place < len(self._held):
                return self._held[self._place]
            if not self._fill(1):
                return ""

    def _fill(self, wanted: int) -> bool:
        """Hold so many letters from here on; False where the file ends before."""
        while len(self._held) - self._place < wanted:
            more = self._file.read(_AHEAD)
            if not more:
                return False
            self._held, self._place = self._held[self._place :] + more, 0
        return True


@contextmanager
def write_features(path: Path, columns: Iterable[str]) -> Iterator[Callable[[Iterable[Record]], None]]:
    """Begin a GeoJSON file; what it gives takes records with `lat` and `lon`, some at a time.

    Args:
        path: The file; one that is there is replaced.
        columns: Which values of a record are a feature's properties.
    """
    names = [name for name in columns if name not in ("lat", "lon")]
    with path.open("w", encoding="utf-8") as file:
        between = ""
        file.write('{"type": "FeatureCollection", "features": [')

        def write(records: Iterable[Record]) -> None:
            nonlocal between
            for record in records:
                lat, lon = record["lat"], record["lon"]
                feature = {
                    "type": "Feature",
                    "geometry": None if lat is None else {"type": "Point", "coordinates": [lon, lat]},
                    "properties": {name: record[name] for name in names},
                }
                written = json_text(feature, indent=None) if is_text(record["path"]) else json.dumps(feature)
                file.write(f"{between}\n{written}")  # names that are not UTF-8 are escaped
                between = ","

        yield write
        file.write("\n]}\n")


def is_text(path: str) -> bool:
    """Whether a name of a file is UTF-8, as it need not be."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True
