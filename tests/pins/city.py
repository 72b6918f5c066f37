"""The index that was written on the day the pins were made: `city.index`, and how it came about.

Twelve drawn streets, described by the fake describer, at paths that are on no machine (`/photos/...`): one without a
position, one whose name is not UTF-8, two that look the same, one removed again. `recorded/city.json` holds what it
answered. `make` made it and still can: an index made today must be that one, byte for byte, but for its date.

    cd tests && PYTHONPATH=../src:. python -m pins.city      # refuses while there is one
"""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import salad
from pins.where import RECORDED, FakeDescriber, Filter, street

CITY = Path(__file__).with_name("city.index")
MODEL = FakeDescriber(dim=48)
HOME = (48.1, 11.5)
EAST = timezone(timedelta(hours=9))
NAMES = (
    "a.jpg",
    "b.jpg",
    "c [red].jpg",
    "東京.jpg",
    "-dash.jpg",
    "sub/f.jpg",
    "sub/g.jpg",
    "h.png",
    "i.jpg",
    "j.jpg",
)
FILTERS: dict[str, Filter | None] = {
    "all": None,
    "box": Filter(box=(48.0, 11.0, 48.1025, 12.0)),
    "near": Filter(near=salad.GeoPoint(48.104, 11.5), within_m=250.0),
    "since": Filter(since=datetime(2024, 5, 4), until=datetime(2024, 5, 8, tzinfo=UTC)),
    "heading": Filter(heading=350.0, heading_within=50.0),
    "nowhere": Filter(near=salad.GeoPoint(-10.0, 0.0), within_m=10.0),
}


def photos() -> list[salad.Photo]:
    """What is known of them: a position every 111 m northwards, a heading, a time with a zone and without."""
    made = []
    for number, name in enumerate((*NAMES, os.fsdecode(b"k\xff.jpg"), "twin of b.jpg")):
        time = datetime(2024, 5, 1 + number, 12, 30, tzinfo=EAST if number % 3 == 0 else None)
        where = None if number == 4 else salad.GeoPoint(HOME[0] + 0.001 * number, HOME[1])
        made.append(salad.Photo(Path("/photos", name), where, None if number == 7 else 40.0 * number % 360, time))
    return made


def descriptors() -> npt.NDArray[np.float32]:
    """Of the streets 0 to 10, and of street 1 again."""
    return MODEL.describe([street(number) for number in (*range(11), 1)])


def make(folder: Path) -> None:
    """Add all in two calls, and remove one."""
    known, rows = photos(), descriptors()
    contents = [f"{number:032x}" for number in range(len(known))]
    with salad.Index.create(folder, dim=MODEL.dim, fingerprint=MODEL.fingerprint, model=MODEL.name) as index:
        index.add(known[:7], rows[:7], identities=contents[:7])
        index.add(known[7:], rows[7:], identities=contents[7:])
        index.remove([known[8].path])


def queries() -> npt.NDArray[np.float32]:
    """The same streets on another day, and one that no photo shows."""
    return np.load(RECORDED / "city_queries.npy")


def answers(folder: Path) -> dict[str, Any]:
    """What the index in `folder` answers and says of itself."""
    with salad.Index.open(folder) as index:
        info = index.info().as_dict()
        found = {
            f"{name}, {'centred' if centred else 'plain'}": [
                [[match.row, str(match.photo.path), match.score] for match in best]
                for best in index.search(queries(), k=4, where=where, centred=centred)
            ]
            for name, where in FILTERS.items()
            for centred in (False, True)
        }
        return {
            "info": {name: value for name, value in info.items() if name != "bytes"},
            "length": len(index),
            "photos": [_told(one) for one in index.photos()],
            "missing": len(index.missing()),
            "search": found,
        }


def _told(photo: salad.Photo) -> list[Any]:
    where, time = photo.where, photo.time
    return [str(photo.path), where and [where.lat, where.lon], photo.heading, time and time.isoformat()]


if __name__ == "__main__":
    if CITY.exists():
        raise SystemExit(f"{CITY} is there: it is frozen, and made anew it would hold nothing")
    RECORDED.mkdir(exist_ok=True)
    np.save(RECORDED / "city_queries.npy", MODEL.describe([street(number, seed=1) for number in (0, 1, 3, 9, 77)]))
    make(CITY)
    (RECORDED / "city.json").write_text(json.dumps(answers(CITY), indent=1) + "\n", encoding="utf-8")
