"""Photos that somebody else names: what of them is opened, decided here for everybody.

Indexes and results are sent from one to another, and what they name are paths. A path may be of any file of the
machine that reads them, and whoever shows, describes or explains that file gives it away: to a page, a model, a
listener. So a photo that an index names is opened only where it is the photo that the index was made of, and one
that a result names only below a folder that the user has named.

Everything that opens such a photo takes one of these in place of a path.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path

from salad.errors import PhotoError, reason
from salad.files import read_file
from salad.images.decode import LONGEST
from salad.images.photo import content_hash


@dataclass(frozen=True, slots=True)
class HeldPhoto:
    """A photo of an index, at the path where it was, with the content it had.

    Attributes:
        path: Its file, as the index names it.
        identity: Its content, as the index holds it (`salad.images.photo.content_hash`).
    """

    path: Path
    identity: str

    def read(self) -> bytes:
        """The bytes of its file.

        Raises:
            PhotoError: If they are not those that were indexed, or there is no such file; never which of the two.
        """
        # One sentence for both: whoever made the index is not to learn what else lies on this machine.
        refused = PhotoError(
            f"{self.path} was changed or is gone since it was indexed: put it back, or index its folder again"
        )
        try:
            content = read_file(self.path, most=LONGEST)
        except (OSError, ValueError) as error:  # the last: no file's name, as one with a NUL
            raise refused from error
        if content_hash(self.path, file=io.BytesIO(content)) != self.identity:
            raise refused
        return content


@dataclass(frozen=True, slots=True)
class PhotoBelow:
    """A photo by its name below a folder, for names that come from a file.

    Attributes:
        folder: What the user named.
        name: As the file has it.
        links: Whether links below the folder are followed out of it, as the user's own walk through it follows them.
    """

    folder: Path
    name: str
    links: bool = False

    @property
    def path(self) -> Path:
        """Where the file should be."""
        return self.folder / self.name

    def read(self) -> bytes:
        """The bytes of its file.

        Raises:
            PhotoError: If it does not lie below the folder, or cannot be read.
        """
        whole = os.path.abspath if self.links else os.path.realpath
        try:
            folder, full = Path(whole(self.folder)), Path(whole(self.path))
            if not full.is_relative_to(folder):
                raise PhotoError(f"{self.name} does not lie below {self.folder}, and is not opened")
            return read_file(full, most=LONGEST, follow=self.links)
        except (OSError, ValueError) as error:
            raise PhotoError(
                f"{self.path} cannot be read ({reason(error)}): check the folder that was given"
            ) from error


NamedPhoto = HeldPhoto | PhotoBelow
