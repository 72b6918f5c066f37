"""The mistakes of an evaluation: what became of each query, which mistakes a page shows, and their strips of photos."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias
from urllib.parse import quote_from_bytes

from salad.evaluation.result import QueryResult, Result
from salad.geo import told_metres
from salad.images.named import PhotoBelow
from salad.report.page import ordinal
from salad.report.strips import CaptionPart, Figure, Strip, Thumbnails

Outcome: TypeAlias = Literal["right", "wrong", "unanswerable"]
OUTCOMES: tuple[Outcome, ...] = ("right", "wrong", "unanswerable")
# Mistakes of a kind on a page: enough to see what they have in common, few enough to look at.
SHOWN = 8
UNANSWERABLE = 4  # queries on it that nothing is right for
SIDE = 256  # pixels of a photo's longer side


def outcome(one: QueryResult) -> Outcome:
    """Whether the best match is right; a query without a right reference can only be answered wrongly."""
    if not one.positives:
        return "unanswerable"
    return "right" if one.hit(1) else "wrong"


def counts(results: Sequence[QueryResult]) -> dict[Outcome, int]:
    """How many came to what, none left out."""
    found = Counter(map(outcome, results))
    return {each: found[each] for each in OUTCOMES}


def surest(results: Sequence[QueryResult], kind: Outcome = "wrong", *, most: int = SHOWN) -> list[int]:
    """The answers of one kind with the highest scores, the surest first; numbers from 0."""
    scored = [(-one.scores[0], number) for number, one in enumerate(results) if one.scores and outcome(one) == kind]
    return [number for _, number in sorted(scored)[:most]]


def worst(results: Sequence[QueryResult], *, besides: Sequence[int] = (), most: int = SHOWN) -> list[int]:
    """The answers farthest from the truth: in metres where known, else by how late the right one came.

    Args:
        results: Of all queries.
        besides: Numbers of queries that are shown already.
        most: How many.
    """
    wrong = {number for number, one in enumerate(results) if outcome(one) == "wrong"} - set(besides)
    by_badness = []
    for number in wrong:
        one, late = results[number], results[number].first_right or 0
        # Known metres come before unknown, never found before found late, sure before unsure.
        far = 1.0 if one.metres is None else -one.metres
        by_badness.append((far, late > 0, -late, -one.scores[0] if one.scores else 0.0, number))
    return [number for *_, number in sorted(by_badness)[:most]]


def in_words(one: QueryResult) -> str:
    """What became of a query, in a few words."""
    if not one.positives:
        return "no reference is right"
    if one.metres is not None:
        return f"{told_metres(one.metres)} off"
    if one.first_right is not None:
        return f"the right one came {ordinal(one.first_right)}"
    return f"not among {len(one.matches)}" if one.matches else "nothing found"


@dataclass(frozen=True, slots=True)
class Section:
    """Mistakes of one kind.

    Attributes:
        title: What kind.
        lede: What is to be learnt from them.
        numbers: Of the queries, from 0.
    """

    title: str
    lede: str
    numbers: Sequence[int]


def sections(result: Result) -> list[Section]:
    """The mistakes that a page shows, kinds without any left out."""
    sure = surest(result.per_query)
    bad = worst(result.per_query, besides=sure)
    believed = surest(result.per_query, "unanswerable", most=UNANSWERABLE)
    far = (
        "farthest from where the photo was taken"
        if result.distances is not None
        else "whose right reference was found last, or not at all"
    )
    kinds = (
        Section(
            "Surest mistakes",
            "Wrong answers with the highest scores: a threshold takes these out last.",
            sure,
        ),
        Section("Worst mistakes", f"Answers {far}.", bad),
        Section(
            "Believed without reason",
            "The highest scores of queries that no reference is right for.",
            believed,
        ),
    )
    return [kind for kind in kinds if kind.numbers]


@dataclass(frozen=True, slots=True)
class MistakeStrips:
    """Makes the strips of a result's queries: what was asked, what was found, what would have been right.

    Attributes:
        result: What the queries are of.
        page: Where the page will stand, since its links to photos begin there.
        thumbnails: Of the page's photos.
        folders: That references and queries are shown from; None for a side that is not shown.
    """

    result: Result
    page: Path
    thumbnails: Thumbnails
    folders: tuple[Path | None, Path | None]

    def strip(self, number: int, *, marked: bool) -> Strip:
        """One query's strip.

        Args:
            number: Of the query, from 0.
            marked: Whether it has a mark on the map, which the strip then leads back to.
        """
        one, known = self.result.per_query[number], self.result.known
        figures = [self._photo("asked", 1, one.query, "Query", CaptionPart("asked"))]
        if one.matches:
            score = (CaptionPart(f"{one.scores[0]:.3f}", "score"),) if one.scores else ()
            name = known[one.matches[0]].name
            figures.append(self._photo("found wrong", 0, name, "Reference", CaptionPart("found"), *score))
        else:
            figures.append(Figure("found", None, "nothing", caption=(CaptionPart("found"),)))
        if one.right is not None and one.right in known:
            first, name = one.first_right, known[one.right].name
            rank = f"found {ordinal(first)}" if first else f"not among the first {len(one.matches)}"
            figures.append(self._photo("missed right", 0, name, "Reference", CaptionPart(f"right: {rank}")))
        else:
            figures.append(Figure("missed", None, "none of the references", caption=(CaptionPart("right"),)))
        return Strip(number + 1, outcome(one), in_words(one), one.query, figures, one.group or "", marked=marked)

    def _photo(self, kind: str, side: int, name: str, role: str, *words: CaptionPart) -> Figure:
        folder, caption = self.folders[side], (*words, CaptionPart(name, "name"))
        if folder is None:
            return Figure(kind, None, f"{name} is not shown", caption=caption)
        photo = PhotoBelow(folder, name, links=not self.result.from_file)
        small = self.thumbnails.of(photo, name, side=SIDE)
        if small is None:
            return Figure(kind, None, f"{name} cannot be opened any more", caption=caption)
        return Figure(kind, small, f"{role} {name}", link(photo.path, self.page), caption)


def link(photo: Path, page: Path) -> str:
    """How a page points to a photo: from its own folder, so that nothing tells whose disk it lay on.

    On another drive than the page's there is no such way, and the link is the file's own.
    """
    full, home = os.path.abspath(photo), os.path.abspath(page.parent)  # noqa: PTH100  # links are left as named
    try:
        way = os.path.relpath(full, home)
    except ValueError:
        return Path(full).as_uri()
    return quote_from_bytes(os.fsencode(way.replace(os.sep, "/")))
