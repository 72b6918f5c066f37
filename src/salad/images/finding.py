"""Finding photos: what of the files, folders and lists that people name is one, and what was passed over.

A disk that people really have holds more than photos: films, raw files, thumbnails that a server drew of each photo,
what was thrown away, and folders that nobody may read. None of it ends a walk, and all of it can be named.
"""

from __future__ import annotations

import fnmatch
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TextIO

from salad.errors import PhotoError, reason
from salad.images.decode import existing
from salad.tables import bounded_lines

SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".webp", ".tif", ".tiff", ".bmp", ".gif"}
    | {".ppm", ".pgm", ".pnm", ".jp2", ".avif", ".heic", ".heif", ".heics", ".hif", ".insp"}
)
"""What a photo's name ends in, in small letters; a folder's other files are not photos."""
SIDECARS = frozenset({".xmp", ".json"})
"""What the files end in that are read beside their photos, and so are not passed over."""
NOT_WALKED = frozenset(
    {"@eadir", "thumbnails", "thumbs", "@__thumb"}  # drawn of photos that lie beside them
    | {"#recycle", "@recycle", "$recycle.bin", "recycler", "#snapshot"}  # thrown away, or kept twice
    | {"__macosx", "system volume information"}  # a system's own
)
"""Folders that are left out unless they are named themselves, in small letters; hidden ones are left out too."""

_LONGEST_ENDING = 12  # letters, its dot among them: what is longer is part of a name
_KINDS = 8  # of what was passed over, told one by one


class PassedOver(NamedTuple):
    """A file that is no photo, or a folder that was not walked.

    Attributes:
        path: As it was found.
        kind: What it is counted under: an ending, a folder's name, or the option that asked for it.
        why: Half a sentence.
    """

    path: str
    kind: str
    why: str


@dataclass(slots=True)
class Found:
    """What files, folders and lists hold.

    Attributes:
        photos: Each once, in the order of the sources.
        unreadable: A sentence for each folder that cannot be read, by its path.
        passed_over: What else lies in the folders, but for hidden files and sidecars.
    """

    photos: list[Path] = field(default_factory=list)
    unreadable: dict[str, str] = field(default_factory=dict)
    passed_over: list[PassedOver] = field(default_factory=list)

    def counted(self) -> str:
        """What was passed over, for people: `12 .mp4, 3 .cr2, 1 @eaDir`; empty where nothing was."""
        counts = Counter(each.kind for each in self.passed_over)
        kinds = sorted(counts.items(), key=lambda kind: (-kind[1], kind[0]))
        told = [f"{count:,} {kind}" for kind, count in kinds[:_KINDS]]
        others = sum(count for _, count in kinds[_KINDS:])
        return ", ".join([*told, *([f"{others:,} of other kinds"] if others else [])])


def find_photos(
    sources: Iterable[str | Path], stdin: TextIO | None = None, *, on_unreadable: Callable[[str], None] | None = None
) -> list[Path]:
    """The photos that files, folders and lists name, each once.

    Folders are walked in order of names, through links but never in circles; what is hidden, the folders of
    `NOT_WALKED` and what does not end in one of `SUFFIXES` are left out. A file given by name is taken whatever it ends
    in. `-` stands for a list on `stdin` (the process's own where not given), one file or folder a line.

    Args:
        sources: Files, folders, and `-`.
        stdin: Where `-` is read from.
        on_unreadable: Takes a sentence for each folder that cannot be read, and the rest goes on; where not given, the
            first of them is raised.

    Raises:
        PhotoError: If a source is missing, a folder holds no photo, or nothing is named.
    """
    found = look_through(sources, stdin)
    for sentence in found.unreadable.values():
        if on_unreadable is None:
            raise PhotoError(sentence)
        on_unreadable(sentence)
    return found.photos


def look_through(
    sources: Iterable[str | Path],
    stdin: TextIO | None = None,
    *,
    exclude: Sequence[str] = (),
    allow_empty: bool = False,
) -> Found:
    """As `find_photos`, and what was passed over on the way.

    Args:
        sources: Files, folders, and `-`.
        stdin: Where `-` is read from.
        exclude: Patterns as shells have them (`*.png`, `raw/*`), of names or of paths below the folder given.
        allow_empty: Whether a folder without a photo will do.

    Raises:
        PhotoError: If a source is missing, a folder holds no photo, or nothing is named.
    """
    found, photos = Found(), dict[Path, None]()
    left_out = _Pattern(exclude)
    for source in sources:
        if source == "":  # an unset variable in a script, which must not mean the folder it runs in
            raise PhotoError("one of the photos named is an empty text: check the script that names it")
        for path in listed(stdin or sys.stdin) if str(source) == "-" else [Path(source)]:
            if os.path.isdir(path):  # noqa: PTH112  # Path.is_dir fails over a name too long
                inside = _walk(path, left_out)
                found.unreadable |= inside.unreadable
                found.passed_over += inside.passed_over
                photos.update(dict.fromkeys(inside.photos))
                if not (inside.photos or inside.unreadable or allow_empty):
                    raise _no_photos(path, inside)
            elif why := left_out.of(path.name, str(path)):
                found.passed_over.append(PassedOver(str(path), "by --exclude", why))
            else:
                photos[existing(path)] = None
    found.photos = list(photos)
    # A folder inside of another that is named too is walked twice.
    found.passed_over = list(dict.fromkeys(found.passed_over))
    if not found.photos and not allow_empty:
        raise PhotoError(next(iter(found.unreadable.values()), _nothing_named(found)))
    return found


def listed(stdin: TextIO) -> list[Path]:
    """The paths a list names, one a line; blank lines are left out.

    Raises:
        PhotoError: If the list is not text.
    """
    try:
        lines = [line.removeprefix("\ufeff").rstrip("\r\n") for line in bounded_lines(stdin)]
    except ValueError as error:  # not UTF-8, or a line without end
        raise PhotoError("the list on standard input is not text: write one path a line, in UTF-8") from error
    return [Path(line) for line in lines if line.strip()]


def _nothing_named(found: Found) -> str:
    if found.passed_over:
        return f"all that was named is left out ({found.counted()}): name other photos, or give another pattern"
    return "no photos are named: give files, folders, or - with a list on standard input"


def _no_photos(folder: Path, inside: Found) -> PhotoError:
    counted = inside.counted()
    return PhotoError(
        f"the folder {folder} holds no photos: none of its files ends in .jpg, .png or the like"
        + (f" (passed over: {counted})" if counted else "")
    )


class _Pattern:
    """The patterns of `--exclude`, as one."""

    def __init__(self, patterns: Sequence[str]) -> None:
        self._patterns = [(each, re.compile(fnmatch.translate(each.rstrip("/")))) for each in patterns]

    def __bool__(self) -> bool:
        return bool(self._patterns)

    def of(self, *names: str) -> str:
        """Why what bears one of these names is left out; empty where it is not."""
        for pattern, compiled in self._patterns:
            if any(compiled.match(name) for name in names):
                return f"it was left out by --exclude {pattern}"
        return ""


def _walk(folder: Path, left_out: _Pattern) -> Found:
    """What a folder and those in it hold, sorted by path."""
    found = Found()
    seen: set[tuple[int, int]] = set()
    top = os.fspath(folder)
    waiting = [top]  # as os.walk goes, which on Python 3.11 calls itself for each folder further down
    while waiting:
        here = waiting.pop()
        folders = []
        try:
            known = os.stat(here)  # noqa: PTH116  # plain texts, as below
            if (known.st_dev, known.st_ino) in seen:  # reached by several links, perhaps from within itself
                continue
            seen.add((known.st_dev, known.st_ino))
            with os.scandir(here) as entries:
                for entry in entries:
                    name = entry.name
                    if name.startswith("."):
                        continue
                    is_folder = _is_folder(entry)
                    # Names as plain texts: a Path for each of a million files would take longer than the walk.
                    ending = name[name.rfind(".") :].lower() if "." in name else ""
                    if why := left_out.of(name, os.path.relpath(entry.path, top)) if left_out else "":
                        found.passed_over.append(PassedOver(entry.path, "by --exclude", why))
                    elif is_folder and name.lower() in NOT_WALKED:
                        why = "a folder of thumbnails, of what was thrown away, or of the system's own"
                        found.passed_over.append(PassedOver(entry.path, name, why))
                    elif is_folder:
                        folders.append(name)
                    elif ending in SUFFIXES:
                        found.photos.append(Path(here, name))
                    elif ending not in SIDECARS:
                        found.passed_over.append(_no_photo(entry.path, ending))
        except OSError as error:
            found.unreadable[here] = f"the folder {here} cannot be read ({reason(error)}): check who may read it"
        waiting += [os.path.join(here, name) for name in sorted(folders, reverse=True)]  # noqa: PTH118
    found.photos.sort()
    found.passed_over.sort()
    return found


def _no_photo(path: str, ending: str) -> PassedOver:
    told = ending if 1 < len(ending) <= _LONGEST_ENDING else ""
    why = f"files that end in {told} are not read" if told else "its name has no ending of a photo"
    return PassedOver(path, told or "without an ending", why)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself
        return False
