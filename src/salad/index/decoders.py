"""Which decoder showed a photo to the model, of the photos of which that matters.

A later decoder may make another picture of a file, and what the index holds of it is then a descriptor of what nobody
sees any more. So it was when deep grey was first shown by the range that it uses. An index remembers it by content,
whatever becomes of the row; of a photo that is not listed the decoder was an earlier one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from salad.images.decode import DECODER
from salad.index.catalog import Catalog

SCHEMA = "CREATE TABLE IF NOT EXISTS decoders (identity TEXT PRIMARY KEY, decoder INTEGER NOT NULL)"


def note_decoder(catalog: Catalog, identities: Sequence[str]) -> None:
    """Inside of a change: these contents are described from what today's decoder makes of them."""
    catalog.change(SCHEMA)
    for identity in identities:
        catalog.change("INSERT OR REPLACE INTO decoders VALUES (?, ?)", (identity, DECODER))


def decoded_earlier(catalog: Catalog, identities: Sequence[str]) -> set[str]:
    """Inside of a look: which of these contents were shown to the model by an earlier decoder."""
    if not catalog.select("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'decoders'"):
        return set(identities)
    sql = "SELECT identity FROM decoders WHERE decoder >= ? AND identity IN (SELECT value FROM json_each(?))"
    return set(identities) - {identity for (identity,) in catalog.select(sql, (DECODER, json.dumps(list(identities))))}
