"""Files beside a photo that say something of it: XMP of photo managers, and the JSON of Google Takeout."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

from salad.errors import reason
from salad.files import read_file
from salad.images.metadata import Position
from salad.images.takeout import LONGEST_JSON, parse_takeout, takeout_names
from salad.images.xmp import LONGEST_XMP, parse_xmp

_NOT_THERE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG})


def sidecar_names(name: str) -> list[str]:
    """What the files beside a photo may be called, those that win first.

    darktable and digiKam write `NAME.EXT.xmp`, Adobe's programs and others `NAME.xmp`, which a RAW and its JPEG share.
    """
    stem = name[: name.rfind(".")] if name.rfind(".") > 0 else name
    spelled = [f"{base}.{ending}" for base in (name, stem) for ending in ("xmp", "XMP")]
    return list(dict.fromkeys((*spelled, *takeout_names(name))))


def read_sidecars(path: Path) -> Iterator[Position]:
    """What the files beside a photo say of it, those that win first; one that cannot be read is named in a remark.

    Args:
        path: The photo; it need not be there.
    """
    for name in sidecar_names(path.name):
        source = "takeout" if name.endswith(".json") else "sidecar"
        try:
            data = read_file(path.with_name(name), most=LONGEST_JSON if source == "takeout" else LONGEST_XMP)
        except (OSError, ValueError) as error:
            # A photo's own name may be as long as names can be, and then nothing is called after it.
            if isinstance(error, OSError) and error.errno not in _NOT_THERE:
                yield Position(source=source, remark=f"{name} beside it cannot be read ({reason(error)})")
            continue
        said = parse_takeout(data, path.name) if source == "takeout" else parse_xmp(data, source=source, told=name)
        if said is not None:
            yield said
