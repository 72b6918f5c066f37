"""The directories of a TIFF, without its pixels: of the files that cameras make of their sensors' own numbers too."""

from __future__ import annotations

import struct

MAGICS = (b"II*\0", b"MM\0*", b"IIRO", b"IIRS", b"MMOR", b"IIU\0")
"""How a TIFF begins, and what Olympus and Panasonic write in its place."""
WIDTH, HEIGHT, BITS, COMPRESSION = 256, 257, 258, 259
STRIPS, ORIENTATION, TILES, SAMPLE_FORMAT, DNG_VERSION = 273, 274, 324, 339, 50706
"""Tags."""

_SUB_DIRECTORIES = 330
_SIZES = {1: "B", 3: "H", 4: "L", 13: "L"}  # types of numbers, as `struct` names them
_MOST = 64  # directories; a camera writes four or five
_LONGEST = 1 << 16  # numbers of a tag

Tags = dict[int, tuple[int, ...]]


def directories(data: bytes) -> list[Tags]:
    """The whole numbers that the directories of a TIFF hold, and theirs within, as far as they make sense."""
    if not data.startswith(MAGICS):
        return []
    order = "<" if data[:2] == b"II" else ">"
    waiting, seen = [*_numbers(data, order, "L", 4, 1)], {0}
    found: list[Tags] = []
    while waiting and len(found) < _MOST:
        at = waiting.pop(0)
        if at in seen:
            continue
        seen.add(at)
        (count,) = _numbers(data, order, "H", at, 1) or (0,)
        tags: Tags = {}
        for entry in range(at + 2, min(at + 2 + 12 * count, len(data) - 11), 12):
            tag, kind, length = struct.unpack_from(f"{order}HHL", data, entry)
            letter = _SIZES.get(kind)
            if letter is None or length > _LONGEST:
                continue
            within = struct.calcsize(f"={letter}") * length <= 4
            (place,) = (entry + 8,) if within else struct.unpack_from(f"{order}L", data, entry + 8)
            tags[tag] = _numbers(data, order, letter, place, length)
        found.append(tags)
        waiting += [*tags.get(_SUB_DIRECTORIES, ()), *_numbers(data, order, "L", at + 2 + 12 * count, 1)]
    return found


def _numbers(data: bytes, order: str, letter: str, at: int, count: int) -> tuple[int, ...]:
    """That many numbers at a place; none where the file ends before."""
    form = f"{order}{count}{letter}"
    whole = at + struct.calcsize(form) <= len(data)
    return struct.unpack_from(form, data, at) if whole else ()
