"""Folders of photos, listed once each: no photo is looked at by itself."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from salad.errors import BenchmarkError
from salad.images.finding import SUFFIXES, find_photos

SIDES = (  # what people call the folders of references and of queries
    ("database", "queries"),
    ("references", "queries"),
    ("refs", "queries"),
    ("ref", "query"),
    ("reference", "query"),
    ("gallery", "queries"),
    ("index", "query"),
)


def names_in(folder: Path) -> frozenset[str]:
    """What a folder holds; nothing where there is no such folder."""
    try:
        return frozenset(os.listdir(folder))  # noqa: PTH208  # names, not a Path for each
    except OSError:
        return frozenset()


def names_below(folder: Path) -> list[str]:
    """The photos below a folder, as paths below it with `/`, in order; hidden ones are left out.

    Raises:
        BenchmarkError: If the folder cannot be read or holds no photo.
    """
    names: list[str] = []
    seen: set[str] = set()
    waiting = [""]
    while waiting:
        below = waiting.pop()
        real = os.path.realpath(folder / below)
        if real in seen:  # a link may lead in a circle
            continue
        seen.add(real)
        try:
            with os.scandir(folder / below) as entries:
                for entry in entries:
                    if entry.name.startswith("."):
                        continue
                    if os.path.splitext(entry.name)[1].lower() in SUFFIXES:  # noqa: PTH122  # a Path for each is slow
                        names.append(below + entry.name)
                    elif entry.is_dir():
                        waiting.append(f"{below}{entry.name}/")
        except OSError as error:
            raise BenchmarkError(
                f"the folder {error.filename} cannot be read ({error.strerror}): name another, or mend its rights"
            ) from error
    if not names:
        raise BenchmarkError(f"{folder} holds no photos: none of its files ends in .jpg, .png or the like")
    return sorted(names)


def two_folders(references: Path, queries: Path) -> tuple[list[Path], list[Path]]:
    """List both folders' photos; a photo in both would find itself and lift every figure.

    Raises:
        BenchmarkError: If a photo is in both.
        PhotoError: If a folder is missing or holds no photo.
    """
    reference_paths, query_paths = find_photos([references]), find_photos([queries])
    both = _real(reference_paths) & _real(query_paths)
    if both:
        raise BenchmarkError(
            f"{len(both)} photos are references and queries at once, the first {min(both)}: "
            "give two folders that share no photo"
        )
    return reference_paths, query_paths


def _real(paths: Iterable[Path]) -> set[str]:
    """Where photos really lie: folders are followed once each, and only links among the photos one by one."""
    folders: dict[str, tuple[str, frozenset[str]]] = {}
    real: set[str] = set()
    # realpath of each of millions of photos would ask the disk for every folder above it, every time.
    for path in paths:
        parent, name = os.path.split(path)
        if parent not in folders:
            with os.scandir(parent or ".") as entries:
                links = frozenset(entry.name for entry in entries if entry.is_symlink())
            folders[parent] = os.path.realpath(parent), links
        home, links = folders[parent]
        real.add(os.path.realpath(path) if name in links else os.path.join(home, name))  # noqa: PTH118  # plain strings
    return real


def frame(name: str) -> int:
    """The last whole number in a photo's name, its suffix left aside.

    Raises:
        BenchmarkError: If there is none.
    """
    numbers = re.findall(r"[0-9]+", Path(name).stem)
    if not numbers:
        raise BenchmarkError(f"{name} has no number in its name to tell its frame: rename it or leave it out")
    return int(numbers[-1])


def in_order(names: Sequence[str]) -> list[str]:
    """Names by the last number in each where all have one, which `9.jpg` and `10.jpg` need; else by name."""
    if all(re.search(r"[0-9]", Path(name).stem) for name in names):
        return sorted(names, key=lambda name: (frame(name), name))
    return sorted(names)


def sides_in(
    root: Path, pairs: Sequence[tuple[str, str]] = SIDES, *, inside: Sequence[str] = ("",)
) -> tuple[Path, Path] | None:
    """The first folders of references and of queries that are there, looked for below `root` and each of `inside`."""
    for below in inside:
        for references, queries in pairs:
            if (root / below / references).is_dir() and (root / below / queries).is_dir():
                return root / below / references, root / below / queries
    return None
