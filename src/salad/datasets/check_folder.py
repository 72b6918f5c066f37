"""What a folder is: the layouts it is in, and the protocols that fit it or nearly do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.datasets.folders import frame
from salad.datasets.protocols import PROTOCOLS, benchmark_of, differences, layouts_in
from salad.datasets.readers.base import Layout, Protocol, Sides
from salad.errors import BenchmarkError

# What layouts were found to hold, by all that decides it: many protocols find the same `@` names in a folder.
Held = dict[tuple[object, ...], Sides | BenchmarkError]


@dataclass(frozen=True, slots=True)
class Finding:
    """What one protocol finds in a folder by one layout; a count is None where it cannot be read or was not looked at.

    Attributes:
        unanswerable: How many queries have no right reference.
        fits: Whether this is the protocol's set.
        missing: What differs or is wrong, as sentences or parts of them; empty where it fits.
    """

    protocol: str
    layout: str
    references: int | None
    queries: int | None
    unanswerable: int | None
    fits: bool
    missing: tuple[str, ...] = ()


def check(root: Path) -> list[Finding]:
    """Look at a folder by every protocol; those that fit come first.

    Raises:
        BenchmarkError: If there is no such folder.
    """
    if not root.is_dir():
        raise BenchmarkError(f"there is no folder {root}: give the folder of a data set")
    name = root.resolve().name.lower()
    held: Held = {}
    findings = [
        _finding(root, protocol, layout, found, held)
        for protocol in PROTOCOLS.values()
        for layout, found in layouts_in(root, protocol)
        # Any set may come in `@` names; without counts to compare, only the folder's name can say that it is meant.
        if protocol.references is not None
        or protocol.yours
        or layout.name != "@ names"
        or any(stem in name for stem in protocol.stems)
    ]
    return sorted(findings, key=lambda finding: not finding.fits)


def _finding(root: Path, protocol: Protocol, layout: Layout, found: Path, held: Held) -> Finding:
    """What a protocol finds by a layout, which is read at most once for all protocols that find the same in it."""
    key: tuple[object, ...] = (layout.name, found, protocol.sides)
    if layout.name != "@ names":  # which read the same whoever asks, and may be millions
        key += (protocol.subset, protocol.zone, protocol.rule)
    if key not in held:
        try:
            held[key] = layout.read(root, found, protocol)
        except BenchmarkError as error:
            held[key] = error
    sides = held[key]
    if isinstance(sides, BenchmarkError):
        return Finding(protocol.name, layout.name, None, None, None, False, (str(sides),))
    unanswerable, wrong = None, list[str]()
    try:
        if protocol.name == "frames":
            for photo in (*sides.references.names, *sides.queries.names):
                frame(photo)  # which says so where a name has no number
        elif not protocol.yours:
            unanswerable, wrong = _compared(root, protocol, sides)
    except BenchmarkError as error:
        wrong = [str(error)]
    counts = len(sides.references), len(sides.queries)
    return Finding(protocol.name, layout.name, *counts, unanswerable, not wrong, tuple(wrong))


def _compared(root: Path, protocol: Protocol, sides: Sides) -> tuple[int | None, list[str]]:
    """How many queries have no answer, and how the counts differ from a published protocol's."""
    references = len(sides.references)
    if protocol.references is not None and abs(references - protocol.references) > protocol.about:
        # Another set altogether: what is right in it is not worked out, which takes its time for a large one.
        return None, [f"expected {protocol.references:,} references, found {references:,}"]
    made = benchmark_of(protocol, sides, name=root.name)
    return made.unanswerable, differences(protocol, made)
