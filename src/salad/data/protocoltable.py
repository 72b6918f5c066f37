"""The table of protocols: what each published figure was measured on, and by which rule."""

from __future__ import annotations

from salad.data.rules import Every, Frames, Paired, Protocol, Radius, Told

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


def _own(name: str, rule: Radius | Told, layout: str, get: str) -> Protocol:
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
        _own("folder", Radius(25.0), "folder", "your own photos, with EXIF GPS, `@` names or a table"),
        _own("frames", Told("the tolerance you give"), "folder", "your own two drives of numbered photos"),
        _own("truth", Told("gt.csv"), "gt.csv", "your own photos and a table query,positives"),
    )
}
