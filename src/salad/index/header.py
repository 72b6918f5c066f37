"""`index.json`: what an index says about itself before anything else is opened."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from salad.errors import StoreError

FORMAT_VERSION = 1
NAME = "index.json"
_KIND = "salad index"


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
        """Write `index.json` into `folder`."""
        fields = {"kind": _KIND, **asdict(self), "created": self.created.isoformat()}
        (folder / NAME).write_text(json.dumps(fields, indent=2) + "\n", encoding="utf-8")

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
                model=str(fields["model"]),
                fingerprint=str(fields["fingerprint"]),
                dim=_whole(fields["dim"]),
                created=datetime.fromisoformat(str(fields["created"])),
                format_version=_whole(version),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise _damaged(folder) from error


def _fields(folder: Path) -> dict[str, object]:
    try:
        fields = json.loads((folder / NAME).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise StoreError(
            f"{folder} is not an index (it has no {NAME}): make one with 'salad index PHOTOS --to {folder}'"
        ) from error
    except OSError as error:
        raise StoreError(
            f"{folder / NAME} cannot be read ({error.strerror}): check its permissions"
        ) from error
    except ValueError as error:
        raise _damaged(folder) from error
    if not isinstance(fields, dict) or fields.get("kind") != _KIND:
        raise _damaged(folder)
    return fields


def _whole(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ValueError(value)
    return value


def _damaged(folder: Path) -> StoreError:
    return StoreError(
        f"{folder / NAME} is damaged or not of a salad index: restore it, or index the photos again"
    )
