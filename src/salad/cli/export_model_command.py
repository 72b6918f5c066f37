"""`salad export-model`: a model as one file for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from salad.cli import terminal
from salad.errors import WeightsError


@dataclass(frozen=True)
class ExportModelCommand:
    """Write a model as one ONNX file by COLMAP's contract, checked against torch on photos before it is kept.

    Its input is `images`, float32 [-1, 3, H, W] of RGB / 255, squeezed to the model's size; its output is `descriptor`,
    float32 [-1, D], of length 1.
    """

    model: Annotated[Positional[str], arg(metavar="MODEL", help="A name of the zoo, a folder or a published file.")]
    to: Path
    """The file to write."""
    photos: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Photos to check it on; pictures made for it where there are none."""
    normalised: bool = False
    """Leave the model's mean and deviation out of the file, for a program that normalises by ImageNet's itself."""

    def run(self) -> int:
        """Export."""
        from salad.images.finding import find_photos
        from salad.models.model_folder import load, write_onnx

        if self.to.exists():  # said before the work, not after it
            raise WeightsError(f"{self.to} exists already; choose another file, or remove it first")
        photos = [] if self.photos is None else find_photos([self.photos], on_unreadable=terminal.say)
        terminal.write(str(write_onnx(load(self.model), self.to, photos, normalised=self.normalised)))
        return terminal.FOUND
