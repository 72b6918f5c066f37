"""A strip: one query's card with its photos side by side, small, and over them what the model threw away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from PIL import Image

from salad.errors import PhotoError
from salad.images.named import NamedPhoto
from salad.images.workers import Workers
from salad.report.explain import cluster_layer, data_uri, dustbin_layer, share_of
from salad.report.page import several

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

QUALITY = 76  # of the JPEGs inside a page: at these sizes more is not seen, and a page is mailed around


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A photo as a page holds it: as data, so that the page stays one file.

    Attributes:
        uri: The photo.
        width: In pixels.
        height: In pixels.
        layers: What may lie over it, by name: the `dustbin`, the `clusters`.
    """

    uri: str
    width: int
    height: int
    layers: Mapping[str, str]


@dataclass(slots=True)
class Thumbnails:
    """Opens each photo of a page once.

    Attributes:
        model: Draws where tokens went over the photos; without it, or without a dustbin, they stand alone.
        clusters: Whether to draw the clusters too, besides the dustbin.
        missing: Names of the photos that cannot be opened.
        dustbins: What the dustbin took of each photo, as a share.
    """

    model: DescriberLike | None = None
    clusters: bool = False
    missing: list[str] = field(default_factory=list)
    dustbins: list[float] = field(default_factory=list)
    _drawn: dict[tuple[Path | NamedPhoto, int], Thumbnail | None] = field(default_factory=dict)

    def of(self, photo: Path | NamedPhoto, name: str, *, side: int) -> Thumbnail | None:
        """A photo with its layers, or None where it cannot be opened.

        Args:
            photo: The file, which a path alone vouches for, or a photo that an index or a result names.
            name: What to call it among the `missing`.
            side: Pixels of its longer side at most.
        """
        if (photo, side) not in self._drawn:
            try:
                self._drawn[photo, side] = self._draw(photo, side)
            except (PhotoError, OSError, ValueError):  # the last: a name from a file that no system takes
                self.missing.append(name)
                self._drawn[photo, side] = None
        return self._drawn[photo, side]

    def _draw(self, photo: Path | NamedPhoto, side: int) -> Thumbnail:
        with Workers(1) as workers:
            shown, layers = Image.fromarray(workers.show(photo, side)), {}
        # Decoded anew for the model: the photo for people is decoded otherwise.
        share = None if self.model is None else share_of(self.model, photo)
        if share is not None:
            self.dustbins.append(float(share.dustbin.mean()))
            layers["dustbin"] = data_uri(dustbin_layer(share))
            if self.clusters:
                layers["clusters"] = data_uri(cluster_layer(share))
        return Thumbnail(data_uri(shown, quality=QUALITY), shown.width, shown.height, layers)

    @property
    def missing_note(self) -> tuple[str, ...]:
        """What to say of the missing ones, if there are any."""
        if not self.missing:
            return ()
        return (
            f"{len(self.missing)} of {several(len(self._drawn), 'photo')} to show cannot be opened where the result "
            f"says, the first {self.missing[0]}: they were moved, or lie on another machine.",
        )

    @property
    def dustbin(self) -> float | None:
        """What the dustbin took over all photos, as a share; None where there is none."""
        return sum(self.dustbins) / len(self.dustbins) if self.dustbins else None


class CaptionPart(NamedTuple):
    """Part of a caption: the text, its style, and what appears when it is pointed at."""

    text: str
    kind: str = ""
    title: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One photo of a strip.

    Attributes:
        kind: Its styles.
        thumbnail: The photo; None where there is none to show.
        alt: The photo in words, or what stands in its place.
        href: Where the photo leads, if anywhere.
        caption: Below it.
    """

    kind: str
    thumbnail: Thumbnail | None
    alt: str
    href: str = ""
    caption: Sequence[CaptionPart] = ()


@dataclass(frozen=True, slots=True)
class Strip:
    """One query's card.

    Attributes:
        number: Of the query, from 1: the card is `#query-N`, its mark on the map `#map-N`.
        outcome: What became of it: its colour and its shape.
        verdict: The same in words.
        name: Of its photo.
        figures: Its photos, the query's own first.
        aside: What else is known of it: its group, its light.
        facts: Named figures, each with what stands small beside it.
        marked: Whether the map has a mark of it to lead back to.
        data: Values that a page's script filters by.
    """

    number: int
    outcome: str
    verdict: str
    name: str
    figures: Sequence[Figure]
    aside: str = ""
    facts: Sequence[tuple[str, str, str]] = ()
    marked: bool = True
    data: Mapping[str, object] = field(default_factory=dict)
