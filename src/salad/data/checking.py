"""What a folder is: the layouts it is in, and the protocols that fit it or nearly do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.data.folders import frame
from salad.data.layouts import LAYOUTS
from salad.data.protocols import PROTOCOLS, benchmark_of, differences, there
from salad.data.rules import Layout, Protocol, Sides
from salad.errors import BenchmarkError


@dataclass(frozen=True, slots=True)
class Finding:
    """What one protocol finds in a folder by one layout.

    Attributes:
        protocol: its name.
        layout: the layout's name.
        references: how many there are; None where they cannot be read.
        queries: how many there are.
        unanswerable: how many of them have no right reference; None where that was not looked at.
        fits: whether this is the protocol's set.
        missing: what differs or is wrong, as sentences or parts of them; empty where it fits.
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
        BenchmarkError: there is no such folder.
    """
    if not root.is_dir():
        raise BenchmarkError(f"there is no folder {root}: give the folder of a data set")
    held: dict[tuple[object, ...], Sides | BenchmarkError] = {}
    findings = [
        _finding(root, protocol, layout, held)
        for protocol in PROTOCOLS.values()
        for layout in there(protocol, root)
        if protocol.references is not None or protocol.yours or _called_so(root, protocol, layout)
    ]
    return sorted(findings, key=lambda finding: not finding.fits)


def _called_so(root: Path, protocol: Protocol, layout: Layout) -> bool:
    """Whether a set without counts is meant: by its folder's name, where its layout is anybody's."""
    name = root.resolve().name.lower()
    return layout.name != "@ names" or any(stem in name for stem in protocol.stems)


def _finding(
    root: Path, protocol: Protocol, layout: Layout, held: dict[tuple[object, ...], Sides | BenchmarkError]
) -> Finding:
    sides = _read(root, protocol, layout, held)
    if isinstance(sides, BenchmarkError):
        return Finding(protocol.name, layout.name, None, None, None, False, (str(sides),))
    counts = len(sides.references), len(sides.queries)
    if protocol.yours:
        faults = _no_frames(sides) if protocol.name == "frames" else ()
        return Finding(protocol.name, layout.name, *counts, None, not faults, faults)
    if protocol.references is not None and abs(counts[0] - protocol.references) > protocol.about:
        wanted = f"expected {protocol.references:,} references, found {counts[0]:,}"
        return Finding(protocol.name, layout.name, *counts, None, False, (wanted,))
    try:
        made = benchmark_of(protocol, sides, name=root.name)
    except BenchmarkError as error:
        return Finding(protocol.name, layout.name, *counts, None, False, (str(error),))
    differ = tuple(differences(protocol, made))
    return Finding(protocol.name, layout.name, *counts, made.unanswerable, not differ, differ)


def _no_frames(sides: Sides) -> tuple[str, ...]:
    """What keeps a user's photos from being frames: a name without a number."""
    try:
        for photos in (sides.references, sides.queries):
            for name in photos.names:
                frame(name)
    except BenchmarkError as error:
        return (str(error),)
    return ()


def _read(
    root: Path, protocol: Protocol, layout: Layout, held: dict[tuple[object, ...], Sides | BenchmarkError]
) -> Sides | BenchmarkError:
    """What a layout holds, read once for all protocols that find the same in it."""
    found = layout.find(root, protocol)
    key: tuple[object, ...] = (layout.name, found, protocol.sides)
    if layout is not LAYOUTS["@ names"]:  # which read the same whoever asks
        key += (protocol.subset, protocol.zone, protocol.rule)
    if key not in held:
        try:
            held[key] = layout.read(root, protocol)
        except BenchmarkError as error:
            held[key] = error
    return held[key]
