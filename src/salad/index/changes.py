"""What an index says of photos it holds, beside what it said before they were met again.

A photo's content is the same, and yet its index may say something else of it: a table was given, a sidecar was
corrected, it was called by another name, or a later salad reads what an earlier one did not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from salad.images.photo import Photo
from salad.index.facts import AT_NULL_ISLAND

_SAME_DEGREES = 1e-7  # 1 cm, and less than any heading is known: the same number, worked out in another way


@dataclass(slots=True)
class Changes:
    """Of how many photos an index says something else than before.

    Attributes:
        positions: Photos with another position.
        times: Photos with another time.
        headings: Photos with another heading.
        first: The first change: `a.jpg, 47.1,8.1 -> 47.2,8.2`.
    """

    positions: int = 0
    times: int = 0
    headings: int = 0
    first: str = ""

    def note(self, before: Photo, after: Photo) -> bool:
        """Count what is new of a photo; whether anything is."""
        place = _differ(_place(before), _place(after)) or before.remark == AT_NULL_ISLAND
        time = before.time != after.time
        heading = _differ(_heading(before), _heading(after))
        self.positions += place
        self.times += time
        self.headings += heading
        if (place or time or heading) and not self.first:
            said, says = (
                _told(photo, "position" if place else "time" if time else "heading") for photo in (before, after)
            )
            self.first = f"{after.path.name}, {said} -> {says}"
        return place or time or heading

    def __str__(self) -> str:
        """`3 positions, 1 time changed; the first: ...`; empty where nothing is new."""
        counts = ((self.positions, "position"), (self.times, "time"), (self.headings, "heading"))
        told = [f"{count:,} {what}{'' if count == 1 else 's'}" for count, what in counts if count]
        return f"{', '.join(told)} changed; the first: {self.first}" if told else ""


def _place(photo: Photo) -> Sequence[float]:
    return () if photo.where is None else (photo.where.lat, photo.where.lon)


def _heading(photo: Photo) -> Sequence[float]:
    return () if photo.heading is None else (photo.heading,)


def _differ(one: Sequence[float], other: Sequence[float]) -> bool:
    return len(one) != len(other) or any(abs(a - b) > _SAME_DEGREES for a, b in zip(one, other, strict=True))


def _told(photo: Photo, what: str) -> str:
    """What is known of a photo's position, time or heading, for people."""
    if what == "time":
        return "none" if photo.time is None else photo.time.isoformat()
    if what == "position" and photo.remark == AT_NULL_ISLAND:
        return "0,0"
    degrees = _place(photo) if what == "position" else _heading(photo)
    return ",".join(f"{each:.9g}" for each in degrees) or "none"
