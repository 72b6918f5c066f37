"""Photos as the page holds them: small, a link to the file, and over it what the model threw away."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote_from_bytes

from PIL import Image

from salad.errors import PhotoError
from salad.evaluation.result import Result
from salad.images.decode import open_rgb
from salad.report.explain import data_uri, dustbin_layer, share_of
from salad.report.words import shown

if TYPE_CHECKING:
    from salad.models.describer import Describes

SIDE = 256  # pixels of a photo's longer side
QUALITY = 74


@dataclass(slots=True)
class Pictures:
    """Opens each photo once.

    Args:
        result: names the photos.
        page: the file that links to them.
        model: draws what its dustbin took over them; nothing is drawn without one.
    """

    result: Result
    page: Path
    model: Describes | None = None
    gone: list[str] = field(default_factory=list)
    opened: int = 0
    shares: list[float] = field(default_factory=list)
    _drawn: dict[Path, str] = field(default_factory=dict)

    def query(self, number: int) -> str:
        """A query's photo, by its number from 0."""
        name = self.result.per_query[number].query
        return self._linked(self.result.folders[1], name, f"Query {name}")

    def reference(self, row: int) -> str:
        """A reference's photo, by its row."""
        name = self.result.known[row].name
        return self._linked(self.result.folders[0], name, f"Reference {name}")

    def _linked(self, folder: str, name: str, alt: str) -> str:
        path = Path(folder, name)
        if path not in self._drawn:
            self._drawn[path] = self._draw(path, name)
        drawn = self._drawn[path]
        if not drawn:
            return f'<span class="picture gone">{shown(name)}<br>cannot be opened any more</span>'
        return f'<a class="picture" href="{link(path, self.page)}"><img alt="{shown(alt)}" {drawn}</a>'

    def _draw(self, path: Path, name: str) -> str:
        """All of the photo's `<img>` but its words, and its heat; empty where it cannot be opened."""
        try:
            photo = open_rgb(path)
        except (PhotoError, OSError, ValueError):  # the last: a name from a file that no system takes
            self.gone.append(name)
            return ""
        self.opened += 1
        small = photo.copy()
        small.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
        uri = data_uri(small, quality=QUALITY)
        drawn = f'width="{small.width}" height="{small.height}" decoding="async" src="{uri}">'
        share = None if self.model is None else share_of(self.model, photo)
        if share is None:
            return drawn
        self.shares.append(float(share.dustbin.mean()))
        return drawn + f'<img class="layer" alt="" src="{data_uri(dustbin_layer(share))}">'


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
