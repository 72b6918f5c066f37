"""Photos of a list, which names them below a folder that it does not name: where the list is, where its photos are."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float64

from salad.datasets.compact_lists import PhotoList
from salad.errors import BenchmarkError

_SOME = 10_000  # entries of a folder below that are looked at: photos may be millions, and lists lie in small folders
_SUFFIXES = (".jpg", ".png", ".jpeg", ".JPG")
_VIEW = re.compile(r"_pitch[0-9]+_yaw[0-9]+\.\w+$")


def photos_at(
    names: Sequence[str],
    tried: Iterable[Path],
    *,
    listed_in: Path,
    where: Float64[np.ndarray, "n 2"] | None = None,
) -> PhotoList:
    """The photos of a list, below the first of the folders that holds the first of them.

    A list may name `.jpg` where the photos are `.png`, as Tokyo 24/7's does. Only the first photo is looked at.

    Args:
        names: Paths below a folder, as the list writes them.
        tried: Folders it may be.
        listed_in: The list, for sentences.
        where: `[N, 2]` latitudes and longitudes in degrees, NaN where unknown.

    Raises:
        BenchmarkError: If the list is empty, or no folder holds its first photo.
    """
    # Lists come from Windows too, and from `find`.
    plain = [name.strip().replace("\\", "/").removeprefix("./") for name in names]
    broken = next((name for name in plain if not name or "\0" in name), None)
    if broken is not None:
        raise BenchmarkError(f"{listed_in} names {broken[:200]!r}, which is no file's name: fetch it again")
    if not plain:
        raise BenchmarkError(f"{listed_in} names no photos: fetch it again")
    # Every repository puts them elsewhere; the first photo is enough to tell where, and to look at each takes minutes.
    folders = list(dict.fromkeys(tried))
    suffix = PurePosixPath(plain[0]).suffix
    for folder in folders:
        for other in (suffix, *_SUFFIXES):
            first = plain[0].removesuffix(suffix) + other
            if (folder / first).is_file():
                swapped = plain if other == suffix else [name.removesuffix(suffix) + other for name in plain]
                return PhotoList(folder, swapped, where=where)
    raise BenchmarkError(
        f"{listed_in} names {plain[0][:200]!r} first, which was looked for in {', '.join(map(str, folders))} and is in "
        "none of them: put the photos there"
    )


def panoramas(names: Sequence[str]) -> tuple[str, ...] | None:
    """The panorama that each photo was cut from, where every name says so: its views are one place."""
    cut = tuple(_VIEW.sub("", name) for name in names)
    return cut if all(len(short) < len(name) for short, name in zip(cut, names, strict=True)) else None


def file_of(root: Path, wanted: Iterable[str]) -> Path | None:
    """The first file so called, big letters or small, in a folder or in one right below it."""
    names = {name.lower() for name in wanted}
    entries = _entries(root)
    folders = (entry for entry in entries if not entry.name.startswith(".") and entry.is_dir())
    below = (entry for folder in folders for entry in _entries(Path(folder.path), _SOME))
    for entry in itertools.chain(entries, below):
        if entry.name.lower() in names and entry.is_file():
            return Path(entry.path)
    return None


def _entries(folder: Path, most: int | None = None) -> list[os.DirEntry[str]]:
    """What a folder holds, in order of names; nothing where it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            return sorted(itertools.islice(entries, most), key=lambda entry: entry.name)
    except OSError:
        return []
