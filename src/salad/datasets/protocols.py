"""Every published way to judge by its name, and a folder read by one of them or refused with what differs.

A figure means nothing without its protocol: MSLS val exists with 740 and with 11,084 queries, Nordland with 1, 2 and 10
frames of tolerance. `PROTOCOLS` is the table of them, with what each published figure was measured on; `LAYOUTS` is
that of the layouts they are read from. `read` makes a benchmark of a folder, whatever layout it is in.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from salad.datasets.benchmark import Benchmark, Unanswerable, from_frames, from_radius, from_truth
from salad.datasets.readers import at_names, dbstruct, gsv_cities, msls, npy_triple, patch_netvlad, two_folders
from salad.datasets.readers.base import EveryNth, Frames, Layout, OwnTable, Protocol, Radius, SameName, Sides, right_by
from salad.datasets.readers.two_folders import TRUTH_TABLE, own_folders
from salad.errors import BenchmarkError
from salad.images.photo_table import PhotoTable

# Which of several layouts a folder is read by is its protocol's to say, so their order here decides nothing.
LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        at_names.LAYOUT,
        msls.LAYOUT,
        dbstruct.LAYOUT,
        npy_triple.LAYOUT,
        patch_netvlad.LAYOUT,
        two_folders.DRIVES,
        two_folders.PAIRS,
        gsv_cities.LAYOUT,
        two_folders.TRUTH,
        two_folders.FOLDER,
    )
}
"""The ways in which sets lie on disk, by name: a reader more is a file in `readers/` and a line here."""

_NETVLAD = "the authors of NetVLAD on request (www.di.ens.fr/willow/research/netvlad)"
_ON_REQUEST = "for research, photos on request"


def _msls(
    name: str, layout: str, queries: int, *, stem: str, subset: str = "", unanswerable: Unanswerable = "miss"
) -> Protocol:
    return Protocol(
        name,
        Radius(25.0),
        ("MSLS tables", layout),
        18_871,
        queries,
        unanswerable=unanswerable,
        stems=(stem,),
        split="val",
        subset=subset,
        get="www.mapillary.com/dataset/places",
        licence="CC BY-NC-SA 4.0",
    )


def _pittsburgh(name: str, stem: str, split: str, references: int, queries: int) -> Protocol:
    return Protocol(
        name,
        Radius(25.0),
        ("@ names", "dbStruct", "npy triple", "npz"),
        references,
        queries,
        stems=(f"{stem}_{split}", stem),  # files say which split they are of, folders need not
        split=split,
        zone="17T",  # its files give metres and no zone: without it no photo has a latitude
        get=_NETVLAD,
        licence=_ON_REQUEST,
    )


def _nordland(name: str, rule: Frames | EveryNth, references: int, queries: int, *layouts: str) -> Protocol:
    return Protocol(
        name,
        rule,
        ("drives", *layouts),
        references,
        queries,
        stems=("nordland",),
        get="NRK's films of the line (nrkbeta.no), by the list of 27,592 frames at github.com/QVPR/Patch-NetVLAD",
        licence="as NRK publishes them: see there",
    )


def _by_folder(name: str, *stems: str, sides: tuple[str, str] = ("database", "queries")) -> Protocol:
    get = "github.com/gmberton/VPR-datasets-downloader, which fetches and names it"
    return Protocol(name, Radius(25.0), ("@ names",), stems=stems, sides=(sides,), get=get, licence="see its page")


def _own_rule(name: str, rule: Radius | OwnTable, layout: str, get: str) -> Protocol:
    return Protocol(name, rule, (layout,), unanswerable="drop", get=get, licence="yours", yours=True)


PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        # One set, judged in two ways, and the commonest cause of figures that do not compare. The small one leaves out
        # 7 of its 747 queries, which have no answer; in the large one such queries count as misses.
        _msls("msls-val-740", "npy triple", 740, stem="msls_val", subset="all", unanswerable="drop"),
        _msls("msls-val-11k", "@ names", 11_084, stem="msls"),
        _pittsburgh("pitts30k-val", "pitts30k", "val", 10_000, 7_608),
        _pittsburgh("pitts30k-test", "pitts30k", "test", 10_000, 6_816),
        _pittsburgh("pitts250k-test", "pitts250k", "test", 83_952, 8_280),
        # Three sets of one film: every tenth frame, every eighth, and all of them with the seasons swapped.
        _nordland("nordland-1f", EveryNth(10, 1), 27_592, 2_760, "npy triple"),
        _nordland("nordland-2f", Frames(2), 27_592, 3_450, "npy triple"),
        _nordland("nordland-10f", Frames(10), 27_592, 27_592, "@ names", "npz"),
        Protocol(
            "sped",
            EveryNth(1, 0),
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
            zone="54S",  # as Pittsburgh's
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
                get="github.com/gmberton/CosPlace on request",
                licence="for research, Street View photos on request",
            )
            for version, queries in ((1, 1_000), (2, 598))
        ),
        # Sets without published counts: their names come with the protocol, their sizes with the folder.
        _by_folder("st-lucia", "st_lucia", "st-lucia", "stlucia"),
        Protocol(
            "amstertime",
            SameName(),
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
            OwnTable("its places"),
            ("GSV-Cities",),
            stems=("gsv-cities", "gsv_cities"),
            get="github.com/amaralibey/gsv-cities",
            licence="CC BY-NC-ND 4.0",
        ),
        # A user's own: what is right is as the options of `read` say.
        _own_rule("folder", Radius(25.0), "folder", "your own photos, with EXIF GPS, `@` names or a table"),
        _own_rule("frames", OwnTable("the tolerance you give"), "folder", "your own two drives of numbered photos"),
        _own_rule("truth", OwnTable("gt.csv"), "gt.csv", "your own photos and a table query,positives"),
    )
}


def protocol_called(name: str) -> Protocol:
    """The protocol of that name.

    Raises:
        BenchmarkError: If there is none.
    """
    if name not in PROTOCOLS:
        raise BenchmarkError(f"there is no protocol {name!r}: give one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


_TAKEN = {  # which options of `read` say what is right in a user's own folders
    "folder": ("queries", "metres", "heading", "table"),
    "frames": ("queries", "tolerance"),
    "truth": ("queries", "truth"),
}


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
        protocol: A name of `PROTOCOLS`.
        root: The set's folder; or, for a user's own set, the folder of references where `queries` is given.
        queries: A user's own folder of queries; by default found beside the references by its name.
        metres: The radius of `folder`, 25 by default.
        tolerance: The tolerance of `frames`, in frames.
        heading: For `folder`, within how many degrees a reference must look the same way.
        table: For `folder`, positions of photos that carry none.
        truth: For `truth`, the table `query,positives`; by default the folder's `gt.csv`.
        layout: A name of `LAYOUTS` to read it by, where several are there.
        any_size: Take a set of other counts too, for trying things out; its protocol then says how many there are.

    Raises:
        BenchmarkError: If there is no such protocol, or the set is not there, is damaged, or has other counts.
        PhotoError: If a user's own folder is missing or holds no photo.
    """
    asked = protocol_called(protocol)
    # A figure by a published name must be measured by that name's rule, and by no other.
    options = {"queries": queries, "metres": metres, "tolerance": tolerance, "heading": heading}
    for option, value in {**options, "table": table, "truth": truth}.items():
        if value is not None and option not in _TAKEN.get(protocol, ()):
            raise BenchmarkError(
                f"{protocol} fixes what is right by itself and takes no {option}: leave it away, or use the protocol "
                "folder, frames or truth"
            )
    if not asked.yours:
        return _published(asked, root, layout, any_size=any_size)
    if layout is not None:
        raise BenchmarkError(f"{protocol} takes two folders as they are and no layout {layout}: leave it away")
    folders = (root, queries) if queries is not None else own_folders(root)
    if folders is None:
        raise _absent(asked, root)
    if protocol == "folder":
        return from_radius(*folders, 25.0 if metres is None else metres, table=table, heading=heading)
    if protocol == "truth":
        return from_truth(*folders, truth or root / TRUTH_TABLE)
    if tolerance is None:
        raise BenchmarkError("the protocol frames needs a tolerance: say how many frames apart is still right")
    return from_frames(*folders, tolerance)


def _published(asked: Protocol, root: Path, name: str | None, *, any_size: bool) -> Benchmark:
    """A published set, by the layout of that name or the first that is there."""
    if name is not None and name not in asked.layouts:
        raise BenchmarkError(
            f"{asked.name} is not read from the layout {name!r}: give one of {', '.join(asked.layouts)}"
        )
    there = [pair for pair in layouts_in(root, asked) if name in (None, pair[0].name)]
    if not there:
        raise _absent(asked, root)
    layout, found = there[0]
    made = benchmark_of(asked, layout.read(root, found, asked), name=root.resolve().name)
    differ = differences(asked, made)
    if not differ:
        return made
    if not any_size:
        raise BenchmarkError(
            f"{root}, read as {layout.name}, is not {asked.name}: {'; '.join(differ)}. Complete the set, or "
            "name another protocol"
        )
    # Said beside every figure that comes of it, so that nobody takes it for the protocol's own.
    counts = f"{len(made.references)} references, {made.counted} queries"
    return replace(made, protocol=f"{asked.name} ({counts})")


def layouts_in(root: Path, asked: Protocol) -> list[tuple[Layout, Path]]:
    """The protocol's layouts that a folder is in, each with the file or folder by which it is known."""
    layouts = (LAYOUTS[name] for name in asked.layouts)
    return [(layout, found) for layout in layouts if (found := layout.find(root, asked)) is not None]


def benchmark_of(asked: Protocol, sides: Sides, *, name: str) -> Benchmark:
    """The benchmark that a protocol makes of two sides, whatever their counts.

    Raises:
        BenchmarkError: If the sides do not hold what the rule needs, or do not fit together.
    """
    source = (f"what is right is as {sides.told_by} says",) if sides.told_by else ()
    return Benchmark(
        name=name,
        protocol=asked.name,
        references=sides.references,
        queries=sides.queries,
        positives=right_by(asked.rule, sides),
        notes=(*sides.notes, *source),
        unanswerable_rule=asked.unanswerable,
        groups=sides.groups,
    )


def differences(asked: Protocol, made: Benchmark) -> list[str]:
    """How a set's counts differ from the protocol's, each as part of a sentence; empty where they do not."""
    # Where queries without an answer are dropped, the published number counts those that have one.
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


def _absent(asked: Protocol, root: Path) -> BenchmarkError:
    looked = [text for name in asked.layouts for text in LAYOUTS[name].looked_for(asked)]
    return BenchmarkError(
        f"{asked.name} is not in {root}{'' if root.is_dir() else ', which is no folder'}: looked for "
        f"{', or '.join(looked)}. Get it from {asked.get} ({asked.licence})"
    )
