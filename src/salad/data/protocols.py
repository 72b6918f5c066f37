"""Every published way to judge by its name, and a folder read by one of them or refused with what differs.

A figure means nothing without its protocol: MSLS val exists with 740 and with 11,084 queries, Nordland with 1, 2 and 10
frames of tolerance. `PROTOCOLS` is the table of them; `read` makes a benchmark of a folder, whatever layout it is in.
"""

from __future__ import annotations

from pathlib import Path

from salad.data.benchmark import Benchmark, from_frames, from_radius, from_truth
from salad.data.layouts import LAYOUTS
from salad.data.layouts.own import TRUTH_TABLE, folders
from salad.data.protocoltable import PROTOCOLS
from salad.data.rules import Layout, Protocol, Sides, right_by
from salad.errors import BenchmarkError
from salad.photos import PhotoTable

__all__ = ["PROTOCOLS", "Protocol", "benchmark_of", "differences", "protocol_called", "read", "there"]


def protocol_called(name: str) -> Protocol:
    """The protocol of that name.

    Raises:
        BenchmarkError: there is none.
    """
    if name not in PROTOCOLS:
        raise BenchmarkError(f"there is no protocol {name!r}: give one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def read(
    protocol: str,
    root: Path,
    *,
    queries: Path | None = None,
    metres: float | None = None,
    tolerance: int | None = None,
    heading: float | None = None,
    table: PhotoTable | None = None,
    truth: Path | None = None,
    layout: str | None = None,
    any_size: bool = False,
) -> Benchmark:
    """Read an evaluation set by a protocol's name.

    Args:
        protocol: a name of `PROTOCOLS`.
        root: the set's folder; or, for a user's own set, the folder of references where `queries` is given.
        queries: a user's own folder of queries; by default found beside the references by its name.
        metres: the radius of `folder`, 25 by default.
        tolerance: the tolerance of `frames`.
        heading: for `folder`, within how many degrees a reference must look the same way.
        table: for `folder`, positions of photos that carry none.
        truth: for `truth`, the table `query,positives`; by default the folder's `gt.csv`.
        layout: a name of `LAYOUTS` to read it by, where several are there.
        any_size: take a set of other counts too, for trying things out; its protocol then says how many there are.

    Raises:
        BenchmarkError: there is no such protocol, the set is not there, is damaged, or has other counts.
        PhotoError: a user's own folder is missing or holds no photo.
    """
    asked = protocol_called(protocol)
    options: dict[str, object] = {
        "queries": queries,
        "metres": metres,
        "tolerance": tolerance,
        "heading": heading,
    }
    options |= {"table": table, "truth": truth}
    given = [name for name, value in options.items() if value is not None]
    odd = [name for name in given if name not in _TAKEN.get(protocol, ())]
    if odd:
        raise BenchmarkError(
            f"{protocol} fixes what is right by itself and takes no {odd[0]}: leave it away, or use the protocol "
            "folder, frames or truth"
        )
    if asked.yours:
        if layout is not None:
            raise BenchmarkError(
                f"{protocol} takes two folders as they are and no layout {layout}: leave it away"
            )
        return _own(asked, root, queries, metres, tolerance, heading, table, truth)
    taken = _layout(asked, root, layout)
    sides = taken.read(root, asked)
    made = benchmark_of(asked, sides, name=root.resolve().name)
    differ = differences(asked, made)
    if not differ:
        return made
    if not any_size:
        raise BenchmarkError(
            f"{root}, read as {taken.name}, is not {asked.name}: {'; '.join(differ)}. Complete the set, or "
            "name another protocol"
        )
    counts = f"{len(made.references)} references, {made.counted} queries"
    return benchmark_of(asked, sides, name=made.name, protocol=f"{asked.name} ({counts})")


def benchmark_of(asked: Protocol, sides: Sides, *, name: str, protocol: str | None = None) -> Benchmark:
    """The benchmark that a protocol makes of two sides, whatever their counts.

    Raises:
        BenchmarkError: the sides do not hold what the rule needs, or do not fit together.
    """
    told = (f"what is right is as {sides.told_by} says",) if sides.told_by else ()
    return Benchmark(
        name=name,
        protocol=protocol or asked.name,
        references=sides.references,
        queries=sides.queries,
        positives=right_by(asked.rule, sides),
        notes=(*sides.notes, *told),
        unanswerable_rule=asked.unanswerable,
        groups=sides.groups,
    )


def differences(asked: Protocol, made: Benchmark) -> list[str]:
    """How a set's counts differ from the protocol's, each as part of a sentence; empty where they do not."""
    what = "queries with an answer" if asked.unanswerable == "drop" else "queries"
    found = (
        ("references", asked.references, len(made.references), asked.about),
        (what, asked.queries, made.counted, 0),
    )
    return [
        f"expected {'about ' if about else ''}{expected:,} {side}, found {count:,}"
        for side, expected, count, about in found
        if expected is not None and abs(count - expected) > about
    ]


def there(asked: Protocol, root: Path) -> list[Layout]:
    """The protocol's layouts that a folder is in."""
    return [LAYOUTS[name] for name in asked.layouts if LAYOUTS[name].find(root, asked) is not None]


_TAKEN = {
    "folder": ("queries", "metres", "heading", "table"),
    "frames": ("queries", "tolerance"),
    "truth": ("queries", "truth"),
}


def _layout(asked: Protocol, root: Path, name: str | None) -> Layout:
    """The layout to read a folder by.

    Raises:
        BenchmarkError: it is in none that the protocol is read from, with what was looked for and where to get it.
    """
    if name is not None and name not in asked.layouts:
        raise BenchmarkError(
            f"{asked.name} is not read from the layout {name!r}: give one of {', '.join(asked.layouts)}"
        )
    found = [layout for layout in there(asked, root) if name in (None, layout.name)]
    if not found:
        raise BenchmarkError(_absent(asked, root))
    return found[0]


def _absent(asked: Protocol, root: Path) -> str:
    looked = [text for name in asked.layouts for text in LAYOUTS[name].looked_for(asked)]
    return (
        f"{asked.name} is not in {root}{'' if root.is_dir() else ', which is no folder'}: looked for "
        f"{', or '.join(looked)}. Get it from {asked.get} ({asked.licence})"
    )


def _own(
    asked: Protocol,
    root: Path,
    queries: Path | None,
    metres: float | None,
    tolerance: int | None,
    heading: float | None,
    table: PhotoTable | None,
    truth: Path | None,
) -> Benchmark:
    """A user's own two folders."""
    found = (root, queries) if queries is not None else folders(root)
    if found is None:
        raise BenchmarkError(_absent(asked, root))
    if asked.name == "frames":
        if tolerance is None:
            raise BenchmarkError(
                "the protocol frames needs a tolerance: say how many frames apart is still right"
            )
        return from_frames(*found, tolerance)
    if asked.name == "truth":
        return from_truth(*found, truth or root / TRUTH_TABLE)
    return from_radius(*found, 25.0 if metres is None else metres, table=table, heading=heading)
