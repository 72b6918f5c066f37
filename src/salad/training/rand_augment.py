"""RandAugment as the paper's training has it: fourteen operations on bytes, each of a strength that never changes.

For each photo three of them are drawn, one after another and with replacement, and a direction for those that have two.
Photos are Pillow images meanwhile, since that is what the operations are defined on: rounded to whole numbers after
each of them, resampled bilinearly, black outside.

Source: Cubuk et al., "RandAugment: Practical automated data augmentation with a reduced search space", 2020; strengths
are bin 9 of 31, as torchvision counts them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageEnhance, ImageOps
from torch import Tensor, nn

Operation = Callable[[Image.Image, int], Image.Image]
"""Takes a photo and a direction, 1 or -1, which those that have only one pay no heed to."""

SHEAR: Final = 0.3 * 9 / 30
"""Pixels that a line moves for each that it is further from the first."""
SHIFT: Final = 150 / 331 * 9 / 30
"""Of the side."""
TURN: Final = 30 * 9 / 30
"""Degrees."""
LIGHT: Final = 0.9 * 9 / 30
"""That brightness, colour, contrast and sharpness are more or less than they were."""
BITS: Final = 7
SUN: Final = 255 - 255 * 9 / 30
"""From this byte on solarising makes a photo its negative."""


def _moved(photo: Image.Image, *coefficients: float) -> Image.Image:
    """Where the pixel at (x, y) comes from (a x + b y + c, d x + e y + f)."""
    return photo.transform(photo.size, Image.Transform.AFFINE, coefficients, Image.Resampling.BILINEAR, fillcolor=0)


def _lit(kind: Callable[[Image.Image], ImageEnhance._Enhance]) -> Operation:
    return lambda photo, sign: kind(photo).enhance(1 + sign * LIGHT)


OPERATIONS: dict[str, Operation] = {
    "identity": lambda photo, _: photo,
    "shear x": lambda photo, sign: _moved(photo, 1, sign * SHEAR, 0, 0, 1, 0),
    "shear y": lambda photo, sign: _moved(photo, 1, 0, 0, sign * SHEAR, 1, 0),
    "translate x": lambda photo, sign: _moved(photo, 1, 0, -sign * int(SHIFT * photo.width), 0, 1, 0),
    "translate y": lambda photo, sign: _moved(photo, 1, 0, 0, 0, 1, -sign * int(SHIFT * photo.height)),
    "rotate": lambda photo, sign: photo.rotate(sign * TURN, Image.Resampling.BILINEAR, fillcolor=0),
    "brightness": _lit(ImageEnhance.Brightness),
    "colour": _lit(ImageEnhance.Color),
    "contrast": _lit(ImageEnhance.Contrast),
    "sharpness": _lit(ImageEnhance.Sharpness),
    "posterize": lambda photo, _: ImageOps.posterize(photo, BITS),
    "solarize": lambda photo, _: ImageOps.solarize(photo, threshold=SUN),  # type: ignore[arg-type]  # it compares bytes with it
    "autocontrast": lambda photo, _: ImageOps.autocontrast(photo),
    "equalize": lambda photo, _: ImageOps.equalize(photo),
}


class RandAugment(nn.Module):
    """Three operations for each photo, drawn from torch's own chance.

    Args:
        count: How many.
    """

    def __init__(self, *, count: int = 3) -> None:
        super().__init__()
        self.count = count

    def forward(self, photos: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 3 height width"]:
        """Change photos in 0..1, each in its own way."""
        which = torch.randint(len(OPERATIONS), (len(photos), self.count)).tolist()
        signs = (2 * torch.randint(2, (len(photos), self.count)) - 1).tolist()
        bytes_ = (photos * 255).round().clamp(0, 255).to("cpu", torch.uint8).permute(0, 2, 3, 1).numpy()
        operations = list(OPERATIONS.values())
        changed = []
        for pixels, drawn, directions in zip(bytes_, which, signs, strict=True):
            photo = Image.fromarray(pixels)
            for number, sign in zip(drawn, directions, strict=True):
                photo = operations[number](photo, sign)
            changed.append(np.asarray(photo))
        return (torch.from_numpy(np.stack(changed)).permute(0, 3, 1, 2) / 255).to(photos)
