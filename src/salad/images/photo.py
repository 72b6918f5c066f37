"""A photo: what is known of it, and which it is; `images/finding.py` finds photos, `images/decode.py` opens them."""

from __future__ import annotations

import hashlib
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from salad.geo import GeoPoint
from salad.images.at_names import parse_at_name
from salad.images.decode import existing, in_memory, naming, on_disk, open_image
from salad.images.embedded import embedded
from salad.images.exif import changed, from_exif
from salad.images.metadata import NOTHING_SAID, Position, settled
from salad.images.sidecars import read_sidecars
from salad.images.xmp import parse_xmp

if TYPE_CHECKING:
    from salad.images.photo_table import PhotoTable


@dataclass(frozen=True, slots=True)
class Photo:
    """A photo and what is known of it.

    Attributes:
        path: Its file.
        where: Where it was taken.
        heading: Which way the camera looked, in degrees clockwise from north, 0 to 360.
        time: When it was taken; local time where it carries no time zone.
        source: Who says where, one of `salad.images.metadata.SOURCES`; None where nobody does, or it is not known who.
        remark: Why it has no position, or what of it was not understood: half a sentence, which may be empty.
    """

    path: Path
    where: GeoPoint | None = None
    heading: float | None = None
    time: datetime | None = None
    source: str | None = field(default=None, compare=False)
    remark: str = field(default="", compare=False)

    @classmethod
    def of(cls, path: Path, known: Position) -> Photo:
        """A photo of which that is known."""
        return cls(path, known.where, known.heading, known.time, known.source, known.remark)

    def as_dict(self) -> dict[str, Any]:
        """This photo as JSON and tables hold it: path, lat, lon, heading, time; None for what is unknown."""
        return {
            "path": str(self.path),
            "lat": self.where.lat if self.where else None,
            "lon": self.where.lon if self.where else None,
            "heading": self.heading,
            "time": self.time.isoformat() if self.time else None,
        }


def read_photo(path: Path, table: PhotoTable | None = None, *, file: IO[bytes] | None = None) -> Photo:
    """A photo with its position, heading and time, each from the first of `salad.images.metadata.SOURCES` that has it.

    Pixels are not decoded: a photo that cannot be opened has no EXIF here, and `decode` says what is wrong.

    Args:
        path: The file.
        table: What is known from elsewhere.
        file: The same file where it is held in memory already.

    Raises:
        PhotoError: If there is no such file.
    """
    path = Path(path) if file is not None else existing(Path(path))
    known = settled(sayings(path, file=file))
    if known.where is None and not known.remark:
        known = replace(known, remark=NOTHING_SAID)
    return placed(Photo.of(path, known), table)


def sayings(path: Path, *, file: IO[bytes] | None = None) -> list[Position]:
    """All that a photo's name, its file and the files beside it say of it, each on its own; `settled` says what counts.

    Args:
        path: The file.
        file: The same file where it is held in memory already; read from its beginning.
    """
    said = [] if (name := parse_at_name(path.name)) is None else [name]
    said += read_sidecars(path)
    with suppress(Exception), on_disk(path) if file is None else nullcontext(file) as source:  # `decode` says why not
        image = open_image(path, source)
        found = embedded(image, source)
        # Of several EXIF the last counts, as exiftool has it.
        said += [from_exif(exif) for exif in reversed(found.exif)]
        said += [parse_xmp(packet) for packet in found.xmp]
        said += [changed(exif) for exif in reversed(found.exif)]
        if found.damaged:
            said.append(Position(source="exif", remark="its EXIF is damaged"))
    return said


def placed(photo: Photo, table: PhotoTable | None) -> Photo:
    """The photo with what a table says of it, which comes before what it says itself."""
    listed = table.get(photo.path) if table else None
    if listed is None:
        return photo
    own = Position(photo.where, photo.heading, photo.time, photo.source, photo.remark)
    known = settled([replace(listed, source="table"), own])
    return Photo.of(photo.path, known)


def content_hash(path: Path, *, file: IO[bytes] | None = None) -> str:
    """Which photo this is, whatever its name: 32 hexadecimal digits of BLAKE2b over the file's bytes.

    Args:
        path: The file.
        file: The same file where it is held in memory already.

    Raises:
        PhotoError: If the file cannot be read.
    """
    path = Path(path)
    source = in_memory(path) if file is None else file
    with naming(path):
        source.seek(0)
        return hashlib.file_digest(source, lambda: hashlib.blake2b(digest_size=16)).hexdigest()  # type: ignore[arg-type]  # typeshed asks for more than it uses
