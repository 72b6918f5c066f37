"""Our figures beside the paper's, as Markdown and as JSON: a table for each protocol, never one of two."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.paper.figures import SOURCE, Claim
from salad.datasets.protocols import PROTOCOLS
from salad.evaluation.result import Result

LEFT_OUT = "Its column of the MSLS challenge is left out: no named protocol judges it."
KS = (1, 5)
POINT = 10  # tenths of a percent
NOTHING, MINUS = "–", "−"


@dataclass(frozen=True, slots=True)
class Judged:
    """A model that was judged.

    Attributes:
        name: Names its row in JSON and its files.
        claim: What the paper says of it.
        spec: What was loaded.
        dim: Numbers in its descriptor; None where it was judged elsewhere.
        fingerprint: Of its weights and settings; empty where they are not known.
        image: Height and width in pixels that photos were squeezed to, where known.
        trained: How, where a run says.
        unlike: Why it is not the paper's model; empty where it is, as far as can be seen.
    """

    name: str
    claim: Claim
    spec: str
    dim: int | None
    fingerprint: str
    image: tuple[int, int] | None
    trained: str = ""
    unlike: tuple[str, ...] = ()

    @property
    def asides(self) -> tuple[str, ...]:
        """Why no difference from the paper is told."""
        return (*self.unlike, *([f"the paper's is {self.claim.aside}"] if self.claim.aside else []))


@dataclass(frozen=True, slots=True)
class Figure:
    """What a model reached on a set."""

    model: Judged
    result: Result

    @property
    def paper(self) -> Mapping[int, float]:
        """The paper's recall by k, under this very protocol."""
        return self.model.claim.figures.get(self.result.protocol, {})

    def difference(self, k: int) -> float | None:
        """Ours less the paper's, each as it is shown: to a tenth; None where the two are not to be compared."""
        if k not in self.paper or self.model.asides:
            return None
        return (_tenths(self.result.recall[k]) - _tenths(self.paper[k])) / 10

    def over(self, k: int) -> bool:
        """Whether it is more than a point from the paper's."""
        difference = self.difference(k)
        return difference is not None and abs(_tenths(difference)) > POINT

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "name": self.model.name,
            "title": self.model.claim.title,
            "spec": self.model.spec,
            "dim": self.model.dim,
            "image": None if self.model.image is None else list(self.model.image),
            "trained": self.model.trained,
            "aside": list(self.model.asides),
            "paper": {str(k): percent for k, percent in self.paper.items()},
            "difference": {str(k): self.difference(k) for k in KS},
            "over": [k for k in KS if self.over(k)],
            "result": self.result.as_dict(),
        }


@dataclass(frozen=True, slots=True)
class Report:
    """All there is so far.

    Attributes:
        figures: In the order they were measured.
        missing: Sentences on what was not run.
        made: When, where and with what: `date`, `machine`, `device` and `versions`.
    """

    figures: list[Figure] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    made: Mapping[str, Any] = field(default_factory=dict)

    @property
    def over(self) -> list[Figure]:
        """What is more than a point from the paper."""
        return [one for one in self.figures if any(one.over(k) for k in KS)]

    def verdict(self) -> str:
        """What came of it, in a sentence."""
        compared = sum(one.difference(k) is not None for one in self.figures for k in KS)
        if not compared:
            return "Nothing that ran has a figure in the paper to be compared with."
        far = sum(one.over(k) for one in self.figures for k in KS)
        return f"{compared - far} of {compared} figures are within one point of the paper's" + (
            f"; {far} are not, and are **bold**." if far else "."
        )

    def as_dict(self) -> dict[str, Any]:
        """The JSON form."""
        return {
            "format": 1,
            "paper": SOURCE,
            **self.made,
            "within": POINT / 10,
            "figures": [one.as_dict() for one in self.figures],
            "missing": self.missing,
        }

    def markdown(self) -> str:
        """The page."""
        found = dict.fromkeys(one.result.protocol for one in self.figures)
        parts = ["# Ours beside the paper's", f"Paper: {SOURCE}. {LEFT_OUT}", self.verdict()]
        parts += [_section(name, [one for one in self.figures if one.result.protocol == name]) for name in found]
        if self.figures:
            parts.append(_models({one.model.name: one.model for one in self.figures}.values()))
        if self.missing:
            parts.append("## Not run\n\n" + "\n".join(f"- {_plain(sentence)}" for sentence in self.missing))
        versions = ", ".join(f"{name} {number}" for name, number in self.made.get("versions", {}).items())
        made = [self.made.get(what, "") for what in ("date", "machine", "device")] + [versions]
        parts.append(f"Made {'; '.join(filter(None, made))}.")
        return "\n\n".join(parts) + "\n"


def _section(protocol: str, figures: Sequence[Figure]) -> str:
    """One protocol's table; what its sets hold is told above it."""
    heads = ["", *(head for k in KS for head in (f"R@{k} ours", f"R@{k} paper", "difference"))]
    rows = [[_plain(one.model.claim.title), *(cell for k in KS for cell in _cells(one, k))] for one in figures]
    right = f"right: {PROTOCOLS[protocol].rule}" if protocol in PROTOCOLS else "the paper has no figure of this"
    sets = dict.fromkeys(_counts(one.result) for one in figures)
    asides = list(dict.fromkeys(aside for one in figures if one.paper for aside in one.model.asides))
    under = [f"\\* Not compared: {_plain('; '.join(asides))}."] if asides else []
    return "\n\n".join([f"## {protocol}", f"{'; '.join(sets)}; {right}.", _table(heads, rows), *under])


def _cells(one: Figure, k: int) -> list[str]:
    """Ours with its interval, the paper's, and the difference."""
    interval = one.result.intervals[k]
    ours = f"{_tenths(one.result.recall[k]) / 10:.1f} ({interval.low:.1f} to {interval.high:.1f})"
    if k not in one.paper:
        return [ours, NOTHING, NOTHING]
    difference = one.difference(k)
    if difference is None:
        return [ours, f"{one.paper[k]:.1f}\\*", NOTHING]
    signed = f"{difference:+.1f}".replace("-", MINUS)
    return [ours, f"{one.paper[k]:.1f}", f"**{signed}**" if one.over(k) else signed]


def _counts(result: Result) -> str:
    rule = "left out" if result.unanswerable_rule == "drop" else "misses"
    lost = f", {result.unanswerable:,} of them without an answer ({rule})" if result.unanswerable else ""
    return f"{result.references:,} references, {result.queries:,} queries{lost}"


def _models(models: Iterable[Judged]) -> str:
    heads = ["model", "loaded", "numbers", "photos", "fingerprint", "trained", "unlike the paper's"]
    rows = [
        [
            _plain(one.claim.title),
            _plain(one.spec),
            NOTHING if one.dim is None else f"{one.dim:,}",
            NOTHING if one.image is None else "{} x {}".format(*one.image),
            one.fingerprint or NOTHING,
            _plain(one.trained) or NOTHING,
            _plain("; ".join(one.unlike)) or NOTHING,
        ]
        for one in models
    ]
    return f"## Models\n\n{_table(heads, rows)}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _plain(text: str) -> str:
    """A name that may hold anything, in one cell of one line."""
    return " ".join(text.replace("|", "\\|").split())


def _tenths(percent: float) -> int:
    """Rounded as a figure is printed, halves up: 92.25 is 92.3."""
    return math.floor(10 * percent + 0.5 + 1e-9)
