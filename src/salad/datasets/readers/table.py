"""One reader for each way in which evaluation sets lie on disk; `LAYOUTS` is the table of them."""

from __future__ import annotations

from salad.datasets.readers import (
    at_names,
    dbstruct,
    gsv_cities,
    msls,
    npy_triple,
    npz,
    own_folders,
    pairs,
    two_drives,
)
from salad.datasets.readers.base import Layout

LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        at_names.LAYOUT,
        msls.LAYOUT,
        dbstruct.LAYOUT,
        npy_triple.LAYOUT,
        npz.LAYOUT,
        two_drives.LAYOUT,
        pairs.LAYOUT,
        gsv_cities.LAYOUT,
        own_folders.TRUTH,
        own_folders.FOLDER,
    )
}
