"""What the tests of drawn pages lean on: a reader of the page, and a model whose photos have a dustbin."""

from __future__ import annotations

from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np

from salad.models.fake import FakeDescriber

VOID = {"meta", "link", "img", "input", "br"}


class Page(HTMLParser):
    """Every tag with its attributes, and whether each was closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.said = ""
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs), f"an attribute twice in {tag}"
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.said += data

    def all(self, tag: str, *classes: str, **has: str) -> list[dict[str, str | None]]:
        """The attributes of every such tag: of these classes, and with these words in other attributes."""
        return [
            attrs
            for name, attrs in self.tags
            if name == tag
            and set(classes) <= set((attrs.get("class") or "").split())
            and all(value in (attrs.get(key) or "").split() for key, value in has.items())
        ]


class Sharing(FakeDescriber):
    """A fake with a dustbin."""

    def token_assignment(self, photo: object) -> object:
        return SimpleNamespace(dustbin=np.full((3, 4), 0.9), cluster=np.arange(12).reshape(3, 4))
