"""A mistake as a strip of photos: what was asked, what was found, what would have been right."""

from __future__ import annotations

from salad.evaluation.result import QueryResult
from salad.geo import told_metres
from salad.report.choosing import outcome
from salad.report.pictures import Pictures
from salad.report.words import ordinal, shown


def draw_strip(number: int, pictures: Pictures, *, marked: bool = True) -> str:
    """One query's card, `id="query-N"` with N from 1.

    Args:
        number: of the query, from 0.
        pictures: of the result that it is one of.
        marked: whether the query has a mark on the map or the drive, which the card then leads back to.
    """
    one = pictures.result.per_query[number]
    group = f'<p class="group">{shown(one.group)}</p>' if one.group is not None else ""
    back = f'<a class="to-map" href="#map-{number + 1}">where it is</a>' if marked else ""
    photos = (
        _figure("asked", pictures.query(number), "asked", shown(one.query)),
        _found(one, pictures),
        _right(one, pictures),
    )
    return f"""
<article class="strip {outcome(one)}" id="query-{number + 1}" tabindex="-1" aria-labelledby="name-{number + 1}">
<header><p class="verdict"><span class="glyph" aria-hidden="true"></span>{_said(one)}</p>
<h3 id="name-{number + 1}" title="{shown(one.query)}">{shown(one.query)}</h3>{group}{back}</header>
<div class="photos">{"".join(photos)}</div></article>"""


def _said(one: QueryResult) -> str:
    if not one.positives:
        return "no reference is right"
    if one.metres is not None:
        return f"{told_metres(one.metres)} off"
    if one.first_right is not None:
        return f"the right one came {ordinal(one.first_right)}"
    return f"not among {len(one.matches)}" if one.matches else "nothing found"


def _found(one: QueryResult, pictures: Pictures) -> str:
    if not one.matches:
        return _figure("found", '<span class="picture gone">nothing</span>', "found", "")
    best = one.matches[0]
    score = f'<span class="score">{one.scores[0]:.3f}</span>' if one.scores else ""
    name = shown(pictures.result.known[best].name)
    return _figure("found wrong", pictures.reference(best), f"found {score}", name)


def _right(one: QueryResult, pictures: Pictures) -> str:
    if one.right is None or one.right not in pictures.result.known:
        return _figure("missed", '<span class="picture gone">none of the references</span>', "right", "")
    rank = (
        f"found {ordinal(one.first_right)}" if one.first_right else f"not among the first {len(one.matches)}"
    )
    name = shown(pictures.result.known[one.right].name)
    return _figure("missed right", pictures.reference(one.right), f"right: {rank}", name)


def _figure(kind: str, picture: str, told: str, name: str) -> str:
    return (
        f'<figure class="{kind}">{picture}<figcaption><span>{told}</span>'
        f'<span class="name">{name}</span></figcaption></figure>'
    )
