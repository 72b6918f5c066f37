"""The demo's match strips as HTML: a query, what the model made of it, and the best references."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from salad.demo.report import distance
from salad.demo.result import WITHIN_M, Judged
from salad.geo import GeoPoint
from salad.images.decode import open_rgb
from salad.index.index import Match
from salad.report.explain import cluster_layer, data_uri, dustbin_layer, share_of

if TYPE_CHECKING:
    from salad.models.describer import Describes

BEST = 3
QUERY_WIDTH, REFERENCE_WIDTH = 480, 320  # pixels: twice of what the page shows, for fine screens


@dataclass(slots=True)
class Pictures:
    """Photos as the page holds them, each with its two layers where the model has a dustbin."""

    model: Describes | None
    shares: list[float] = field(default_factory=list)
    _drawn: dict[tuple[Path, int], str] = field(default_factory=dict)

    def stack(self, path: Path, alt: str, *, width: int) -> str:
        """A photo under its dustbin and its clusters; the page's switch says what is seen."""
        if (path, width) not in self._drawn:
            self._drawn[path, width] = self._draw(path, width)
        return f'<span class="picture"><img alt="{escape(alt)}" {self._drawn[path, width]}</span>'

    def _draw(self, path: Path, width: int) -> str:
        """All of the photo's `<img>` but its alternative text, and its layers."""
        photo = open_rgb(path)
        height = max(1, round(photo.height * width / photo.width))
        small = photo.resize((width, height), Image.Resampling.LANCZOS)
        uri = data_uri(small, quality=78)
        drawn = f'width="{width}" height="{height}" decoding="async" src="{uri}">'
        share = share_of(self.model, photo) if self.model else None
        if share is None:
            return drawn
        self.shares.append(float(share.dustbin.mean()))
        layers = {"dustbin": dustbin_layer(share), "clusters": cluster_layer(share)}
        return drawn + "".join(
            f'<img class="layer {name}" alt="" src="{data_uri(layer)}">' for name, layer in layers.items()
        )


def draw_strip(number: int, one: Judged, pictures: Pictures) -> str:
    """One query's card, `id="query-N"`, with a way back to its mark on the map."""
    name = one.answer.query.name
    matches = "".join(_reference(one, match, pictures) for match in one.answer.matches[:BEST])
    query = pictures.stack(
        one.answer.query, f"Query {name}, taken in this light: {one.condition}", width=QUERY_WIDTH
    )
    return f"""
<article class="strip {one.verdict}" id="query-{number}" data-n="{number}" tabindex="-1"
  data-condition="{escape(one.condition)}" data-verdict="{one.verdict}" aria-labelledby="name-{number}">
<header><p class="verdict"><span class="glyph" aria-hidden="true"></span>{_verdict(one)}</p>
<h3 id="name-{number}">{escape(name)}</h3><p class="condition">{escape(one.condition)}</p>
<a class="to-map" href="#map-{number}">on the map</a></header>
<div class="photos"><figure class="query-photo">{query}
<figcaption>taken at {coordinates(one.truth)}</figcaption></figure>
<dl class="facts">{_facts(one)}</dl>
{matches or '<p class="none">no references</p>'}</div></article>"""


def _reference(one: Judged, match: Match, pictures: Pictures) -> str:
    off = one.off_by(match)
    kind = "plain" if off is None else "right" if off <= WITHIN_M else "wrong"
    away = "position unknown" if off is None else f"{distance(off)} away"
    name = match.photo.path.name
    picture = pictures.stack(
        match.photo.path, f"Reference {name}, {away}, score {match.score:.2f}", width=REFERENCE_WIDTH
    )
    return (
        f'<figure class="reference {kind}">{picture}<figcaption><span class="score" title="how alike; '
        f'1 is the same picture">{match.score:.2f}</span> <span class="away">{away}</span></figcaption></figure>'
    )


def _verdict(one: Judged) -> str:
    if one.error_m is None:
        return "unknown"
    return f"{distance(one.error_m)} off"


def _facts(one: Judged) -> str:
    place = one.answer.place
    if place is None:
        facts = {"Found": "unknown: the matches disagree, or score too low"}
    else:
        facts = {
            "Found": f"{coordinates(place.where)} <small>± {distance(place.radius_m)}</small>",
            "Confidence": f"{place.confidence:.2f}",
            "Support": f"{place.support} of {len(one.answer.matches)} matches",
        }
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in facts.items())


def coordinates(point: GeoPoint) -> str:
    """Degrees to about a metre, with their hemisphere."""
    north, east = "NS"[point.lat < 0], "EW"[point.lon < 0]
    return f"{abs(point.lat):.5f}° {north}, {abs(point.lon):.5f}° {east}"
