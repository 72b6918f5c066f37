"""What may change between two photos of one place: viewpoint, light, season, camera and what stands in the way."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import MissingExtraError


class LowResolution(nn.Module):
    """Some photos come as thumbnails: shrink a share of them to a random size and blow them up again."""

    def __init__(self, *, p: float = 0.3, smallest: float = 0.15, largest: float = 0.6) -> None:
        super().__init__()
        self.p, self.smallest, self.largest = p, smallest, largest

    def forward(self, photos: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch 3 height width"]:
        """Coarsen a random share of the photos."""
        size = photos.shape[-2:]
        out = photos.clone()
        for number in torch.nonzero(torch.rand(len(photos)) < self.p).flatten().tolist():
            share = float(torch.empty(1).uniform_(self.smallest, self.largest))
            small = [max(8, int(side * share)) for side in size]
            coarse = F.interpolate(photos[number : number + 1], size=small, mode="bilinear", antialias=True)
            out[number] = F.interpolate(coarse, size=size, mode="bilinear")[0]
        return out


def augmentation(height: int, width: int) -> nn.Module:
    """Photos in 0..1 -> photos as another camera might have taken them, fresh at every call.

    Raises:
        MissingExtraError: kornia is not installed.
    """
    try:
        from kornia import augmentation as k
    except ImportError as error:
        raise MissingExtraError("training", "train") from error
    return nn.Sequential(
        # viewpoint: nearer, to the side, tilted
        k.RandomResizedCrop((height, width), scale=(0.3, 1.0), ratio=(0.6, 1.66)),
        k.RandomPerspective(0.4, p=0.4),
        k.RandomAffine(
            8, translate=(0.1, 0.1), scale=(0.65, 1.05), shear=8, padding_mode="reflection", p=0.4
        ),
        # light: time of day, exposure, white balance, grey cameras
        k.ColorJiggle(brightness=0.3, contrast=0.3, saturation=0.4, p=0.5),
        k.RandomGamma((0.4, 2.5), p=0.3),
        k.RandomPlanckianJitter(p=0.2),
        k.RandomGrayscale(p=0.15),
        # camera
        LowResolution(),
        k.RandomGaussianBlur((7, 7), (0.3, 2.0), p=0.15),
        k.RandomGaussianNoise(std=0.04, p=0.25),
        # what stands in the way
        k.RandomErasing(scale=(0.02, 0.25), p=0.3),
    )
