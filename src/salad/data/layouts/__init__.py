"""One reader for each way in which evaluation sets lie on disk; `LAYOUTS` is the table of them."""

from __future__ import annotations

from salad.data.layouts import atnames, dbstruct, drives, gsv, msls, npytriple, npz, own, pairs
from salad.data.rules import Layout

LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        atnames.LAYOUT,
        msls.LAYOUT,
        dbstruct.LAYOUT,
        npytriple.LAYOUT,
        npz.LAYOUT,
        drives.LAYOUT,
        pairs.LAYOUT,
        gsv.LAYOUT,
        own.TRUTH,
        own.FOLDER,
    )
}
