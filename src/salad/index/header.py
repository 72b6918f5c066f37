"""`index.json`: the model an index was made with, and the form it is written in."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from salad.errors import StoreError
from salad.files import read_json, write_whole

FORMAT_VERSION = 2
HEADER_FILE = "index.json"
_KIND = "salad index"
_MOST_BYTES = 1 << 16
_MOST_NUMBERS = 1 << 24  # in a descriptor
_MOST_LETTERS = 1000  # of the names in it


@dataclass(frozen=True, slots=True)
class Header:
    """The model an index was made with, and the form it is written in.

    Attributes:
        model: Name of the model, for people.
        fingerprint: The model's fingerprint: weights and preprocessing, for the machine.
        dim: Numbers in a descriptor.
        created: When the index was made, UTC.
        format_version: The form of the folder, see docs/index-format.md.
    """

    model: str
    fingerprint: str
    dim: int
    created: datetime
    format_version: int = FORMAT_VERSION

    def write(self, folder: Path) -> None:
        """Write `index.json` into `folder`.

        Raises:
            OSError: If it cannot be written.
        """
        _write(folder, {"kind": _KIND, **asdict(self), "created": self.created.isoformat()})

    def raised(self, folder: Path) -> Header:
        """Say in `folder` that it has today's form, so that a salad that does not know it leaves it alone.

        Raises:
            OSError: If that cannot be written.
        """
        if self.format_version == FORMAT_VERSION:
            return self
        fields = _fields(folder)  # with what else may stand there
        _write(folder, {**fields, "format_version": FORMAT_VERSION})
        return replace(self, format_version=FORMAT_VERSION)

    @classmethod
    def read(cls, folder: Path) -> Header:
        """Read `index.json` of `folder`.

        Raises:
            StoreError: If there is none, it is not ours, or a newer version of salad wrote it.
        """
        fields = _fields(folder)
        version = fields.get("format_version")
        if isinstance(version, int) and version > FORMAT_VERSION:
            raise StoreError(
                f"{folder} was written by a newer salad (index format {version}, this one reads up to "
                f"{FORMAT_VERSION}): upgrade salad to use it"
            )
        try:
            return cls(
                model=_name(fields["model"]),
                fingerprint=_name(fields["fingerprint"]),
                dim=_whole(fields["dim"], most=_MOST_NUMBERS),
                created=datetime.fromisoformat(_name(fields["created"])),
                format_version=_whole(version, most=FORMAT_VERSION),
            )
        except (KeyError, ValueError) as error:
            raise _damaged(folder) from error


def _fields(folder: Path) -> dict[str, Any]:
    path = folder / HEADER_FILE
    try:
        fields = read_json(path, most=_MOST_BYTES, follow=False)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise StoreError(
            f"{folder} is not an index (it has no {HEADER_FILE}): make one with 'salad index PHOTOS --to {folder}'"
        ) from error
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error.strerror}): check its permissions") from error
    except ValueError as error:
        raise _damaged(folder) from error
    if not isinstance(fields, dict) or fields.get("kind") != _KIND:
        raise _damaged(folder)
    return fields


def _write(folder: Path, fields: dict[str, Any]) -> None:
    write_whole(folder / HEADER_FILE, (json.dumps(fields, indent=2) + "\n").encode())


def _name(value: object) -> str:
    if not isinstance(value, str) or len(value) > _MOST_LETTERS:
        raise ValueError(value)
    return value


def _whole(value: object, *, most: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:  # JSON's true is one to Python
        raise ValueError(value)
    return value


def _damaged(folder: Path) -> StoreError:
    return StoreError(
        f"{folder / HEADER_FILE} is damaged or not of a salad index: restore it, or index the photos again"
    )
