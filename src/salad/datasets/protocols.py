"""Every published way to judge by its name, and a folder read by one of them or refused with what differs.

A figure means nothing without its protocol: MSLS val exists with 740 and with 11,084 queries, Nordland with 1, 2 and 10
frames of tolerance. `PROTOCOLS` is the table of them; `read` makes a benchmark of a folder, whatever layout it is in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.datasets.benchmark import Benchmark, from_frames, from_radius, from_truth
from salad.datasets.folders import frame
from salad.datasets.readers.base import Every, Frames, Layout, Paired, Protocol, Radius, Sides, Told, right_by
from salad.datasets.readers.own_folders import TRUTH_TABLE, folders
from salad.datasets.readers.table import LAYOUTS
from salad.errors import BenchmarkError
from salad.images.photo import PhotoTable

# --- The table of protocols: what each published figure was measured on, and by which rule ---


_NETVLAD = "the authors of NetVLAD on request (www.di.ens.fr/willow/research/netvlad)"
_DOWNLOADER = "github.com/gmberton/VPR-datasets-downloader, which fetches and names it"
_ON_REQUEST = "for research, photos on request"
_MSLS = ("www.mapillary.com/dataset/places", "CC BY-NC-SA 4.0")
_NORDLAND = (
    "NRK's films of the line (nrkbeta.no), by the list of 27,592 frames at github.com/QVPR/Patch-NetVLAD",
    "as NRK publishes them: see there",
)
_SFXL = ("github.com/gmberton/CosPlace on request", "for research, Street View photos on request")


def _pittsburgh(name: str, stem: str, split: str, references: int, queries: int) -> Protocol:
    return Protocol(
        name,
        Radius(25.0),
        ("@ names", "dbStruct", "npy triple", "npz"),
        references,
        queries,
        stems=(f"{stem}_{split}", stem),
        split=split,
        zone="17T",
        get=_NETVLAD,
        licence=_ON_REQUEST,
    )


def _nordland(name: str, rule: Frames | Every, references: int, queries: int, *layouts: str) -> Protocol:
    get, licence = _NORDLAND
    return Protocol(
        name, rule, ("drives", *layouts), references, queries, stems=("nordland",), get=get, licence=licence
    )


def _by_folder(name: str, *stems: str, sides: tuple[str, str] = ("database", "queries")) -> Protocol:
    return Protocol(
        name, Radius(25.0), ("@ names",), stems=stems, sides=(sides,), get=_DOWNLOADER, licence="see its page"
    )


def _own_rule(name: str, rule: Radius | Told, layout: str, get: str) -> Protocol:
    return Protocol(name, rule, (layout,), unanswerable="drop", get=get, licence="yours", yours=True)


PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            "msls-val-740",
            Radius(25.0),
            ("MSLS tables", "npy triple"),
            18_871,
            740,
            unanswerable="drop",
            stems=("msls_val",),
            split="val",
            subset="all",
            get=_MSLS[0],
            licence=_MSLS[1],
        ),
        Protocol(
            "msls-val-11k",
            Radius(25.0),
            ("MSLS tables", "@ names"),
            18_871,
            11_084,
            stems=("msls",),
            split="val",
            get=_MSLS[0],
            licence=_MSLS[1],
        ),
        _pittsburgh("pitts30k-val", "pitts30k", "val", 10_000, 7_608),
        _pittsburgh("pitts30k-test", "pitts30k", "test", 10_000, 6_816),
        _pittsburgh("pitts250k-test", "pitts250k", "test", 83_952, 8_280),
        _nordland("nordland-1f", Every(10, 1), 27_592, 2_760, "npy triple"),
        _nordland("nordland-2f", Frames(2), 27_592, 3_450, "npy triple"),
        _nordland("nordland-10f", Frames(10), 27_592, 27_592, "@ names", "npz"),
        Protocol(
            "sped",
            Every(1, 0),
            ("drives", "@ names", "npy triple"),
            607,
            607,
            stems=("sped",),
            get="VPR-Bench (github.com/MubarizZaffar/VPR-Bench)",
            licence="for research: webcams",
        ),
        Protocol(
            "tokyo247",
            Radius(25.0),
            ("@ names", "dbStruct", "npz"),
            75_984,
            315,
            stems=("tokyo247",),
            zone="54S",
            get=_NETVLAD,
            licence=_ON_REQUEST,
        ),
        *(
            Protocol(
                f"sfxl-v{version}",
                Radius(25.0),
                ("@ names",),
                2_800_000,
                queries,
                about=50_000,  # the published number is round
                stems=("sf_xl", "sfxl"),
                sides=(("database", f"queries_v{version}"),),
                get=_SFXL[0],
                licence=_SFXL[1],
            )
            for version, queries in ((1, 1_000), (2, 598))
        ),
        _by_folder("st-lucia", "st_lucia", "st-lucia", "stlucia"),
        Protocol(
            "amstertime",
            Paired(),
            ("pairs", "@ names"),
            stems=("amstertime",),
            get="4TU.ResearchData (data.4tu.nl, AmsterTime)",
            licence="see its page",
        ),
        _by_folder("eynsham", "eynsham"),
        _by_folder("svox", "svox", sides=("gallery", "queries")),
        *(
            _by_folder(f"svox-{weather}", "svox", sides=("gallery", f"queries_{weather}"))
            for weather in ("night", "overcast", "rain", "snow", "sun")
        ),
        Protocol(
            "gsv-cities",
            Told("its places"),
            ("GSV-Cities",),
            stems=("gsv-cities", "gsv_cities"),
            get="github.com/amaralibey/gsv-cities",
            licence="CC BY-NC-ND 4.0",
        ),
        _own_rule("folder", Radius(25.0), "folder", "your own photos, with EXIF GPS, `@` names or a table"),
        _own_rule(
            "frames", Told("the tolerance you give"), "folder", "your own two drives of numbered photos"
        ),
        _own_rule("truth", Told("gt.csv"), "gt.csv", "your own photos and a table query,positives"),
    )
}


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


# --- What a folder is: the layouts it is in, and the protocols that fit it or nearly do ---


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
