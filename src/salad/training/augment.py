"""What may change between two photos of one place: viewpoint, light, season, camera and what stands in the way.

Every change works on tensors, draws from torch's own chance, and gives photos in 0..1 of the size asked for.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError, needs_extra
from salad.training.rand_augment import RandAugment

Photos = Float[Tensor, "batch 3 height width"]
Augmentation = Literal["lite", "paper", "kornia", "robust", "none"]
CUTTING: frozenset[Augmentation] = frozenset({"lite", "robust"})
"""Those that cut the photo they make out of the one they are given, which may be larger."""

_LUMA = (0.299, 0.587, 0.114)  # how bright red, green and blue look
_LAMPS = 3  # most street lamps in a photo
_SHEAR = 0.095  # kornia takes fractions of half a turn: at 9 of 30 this is the 5 degrees that others have


def augmentation(name: Augmentation, height: int, width: int) -> nn.Module:
    """Photos in 0..1 -> photos as another camera might have taken them, fresh at every call.

    Args:
        name: `lite`, as the model that ships was trained; `paper`, RandAugment of three operations; `kornia`,
            that library's, as `paper` was until 2026-11; `robust`, also night, fog, snow, rain and compression; `none`.
        height: of the photos made, in pixels; but for those that are cutting, of the photos given too.
        width: the same.

    Raises:
        MissingExtraError: If kornia is not installed.
        ModelError: If there is none of that name.
    """
    changes: list[nn.Module] = []
    if name == "lite":
        changes = lite_changes(height, width)
    elif name == "paper":
        changes = [RandAugment()]
    elif name == "kornia":
        changes = kornia_changes()
    elif name == "robust":
        changes = robust_changes(height, width)
    elif name != "none":
        raise ModelError(f"there is no augmentation {name!r}: choose one of {', '.join(get_args(Augmentation))}")
    # In 0..1 again, whatever noise and rounding made of it.
    together = nn.Sequential(*changes, nn.Hardtanh(0, 1))
    return together.requires_grad_(False)  # kornia's policies carry numbers that could be learnt


def lite_changes(height: int, width: int) -> list[nn.Module]:
    """Nothing here may change, nor its order: the weights that ship must come out of it again."""
    k = _kornia()
    return [
        # viewpoint: a little nearer, to the side, tilted; what is much nearer is another place along the road
        k.RandomResizedCrop((height, width), scale=(0.65, 1.0), ratio=(0.75, 1.33)),
        k.RandomPerspective(0.3, p=0.4),
        k.RandomAffine(8, translate=(0.1, 0.1), scale=(0.85, 1.1), shear=8, padding_mode="reflection", p=0.4),
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
    ]


def kornia_changes() -> list[nn.Module]:
    """RandAugment by kornia at about the paper's strengths: thirteen operations, of which three different are drawn."""
    _kornia()
    from kornia.augmentation.auto import RandAugment as OfKornia

    moves = {"rotate": 30.0, "shear_x": _SHEAR, "shear_y": _SHEAR, "translate_x": 0.45, "translate_y": 0.45}
    others = [
        ("auto_contrast", 0.0, 1.0),
        ("equalize", 0.0, 1.0),
        ("posterize", 4.0, 8.0),
        ("solarize", 0.57, 1.0),
    ]
    # kornia goes `m` / 30 of the way from the first bound to the second, and knows one direction at a time: so a
    # photo is given to one of two, of which one brightens and the other darkens.
    both = []
    for least, most in ((1.0, 1.9), (0.61, 1.0)):
        lights = [(name, least, most) for name in ("brightness", "color", "contrast", "sharpness")]
        operations = [*lights, *((name, -far, far) for name, far in moves.items()), *others]
        both.append(OfKornia(n=3, m=9, policy=[[operation] for operation in operations]))
    return [OneByOne(*both)]


def robust_changes(height: int, width: int) -> list[nn.Module]:
    """More of everything, and night and weather: for photos unlike those a model has learnt from."""
    k = _kornia()
    rain: list[nn.Module] = []
    longest, aside = height // 12, width // 40  # pixels of a streak
    if longest >= 2:  # a smaller photo has no room for streaks
        drops = max(1, height * width // 300)
        rain.append(
            k.RandomRain(
                number_of_drops=(drops // 3, drops),
                drop_height=(longest // 2, longest),
                drop_width=(-aside, aside),
                p=0.08,
            )
        )
    return [
        # viewpoint
        k.RandomResizedCrop((height, width), scale=(0.3, 1.0), ratio=(0.6, 1.66)),
        k.RandomPerspective(0.5, p=0.4),
        k.RandomAffine(10, translate=(0.1, 0.1), scale=(0.65, 1.05), shear=8, padding_mode="reflection", p=0.4),
        # weather and hour
        Fog(p=0.12),
        k.RandomSnow(snow_coefficient=(0.1, 0.5), brightness=(1.2, 2.5), p=0.08),
        *rain,
        Night(p=0.2),
        # light
        k.ColorJiggle(brightness=0.3, contrast=0.3, saturation=0.5, hue=0.03, p=0.5),
        k.RandomGamma((0.4, 2.5), p=0.25),
        k.RandomPlanckianJitter(p=0.2),
        k.RandomGrayscale(p=0.15),
        # camera
        LowResolution(),
        k.RandomGaussianBlur((7, 7), (0.3, 2.5), p=0.15),
        k.RandomMotionBlur((3, 9), 90.0, (-1.0, 1.0), p=0.1),
        k.RandomGaussianNoise(std=0.05, p=0.25),
        nn.Hardtanh(0, 1),  # JPEG is of whole numbers within a byte
        k.RandomJPEG(jpeg_quality=(8.0, 60.0), p=0.3),
        # what stands in the way
        k.RandomErasing(scale=(0.02, 0.3), p=0.35),
    ]


class Sometimes(nn.Module):
    """A change that happens to a random fraction of the photos; the others stay as they are.

    Args:
        p: the fraction, 0..1.
    """

    def __init__(self, *, p: float) -> None:
        super().__init__()
        self.p = p

    def forward(self, photos: Photos) -> Photos:
        """Change as many as chance takes."""
        taken = torch.nonzero(torch.rand(len(photos)) < self.p).flatten().to(photos.device)
        out = photos.clone()
        if len(taken):
            out[taken] = self.changed(photos[taken])
        return out

    def changed(self, photos: Photos) -> Photos:
        """Change all of them."""
        raise NotImplementedError


class Night(Sometimes):
    """After dark: shadows sink, colours fade, lamps shed warm light around them, and the camera is noisy.

    A camera opens up in the dark, so that a photo that was dark before stays as light as it was.
    """

    def changed(self, photos: Photos) -> Photos:
        """Photos as of a night."""
        before = photos.clamp(0, 1)
        sunk = before ** _drawn(photos, 1.2, 2.2)
        light = torch.minimum(_drawn(photos, 0.07, 0.25), before.mean(dim=(1, 2, 3), keepdim=True))
        dark = sunk * light / sunk.mean(dim=(1, 2, 3), keepdim=True).clamp(min=1e-6)
        grey = (dark * photos.new_tensor(_LUMA).view(1, 3, 1, 1)).sum(dim=1, keepdim=True)
        faded = torch.lerp(dark, grey, _drawn(photos, 0.2, 0.8))
        warm = [_drawn(photos, 1.0, 1.3), _drawn(photos, 0.8, 1.0), _drawn(photos, 0.4, 0.9)]
        lit = faded * torch.cat(warm, dim=1) * (1 + self._lamps(photos) * _drawn(photos, 0.5, 3.0))
        noise = torch.randn(photos.shape).to(photos) * _drawn(photos, 0.0, 0.06)
        return (lit + noise).clamp(0, 1)

    @staticmethod
    def _lamps(photos: Photos) -> Float[Tensor, "batch 1 height width"]:
        """Up to three round glows in the upper half of each photo, 0..1 each."""
        rows = torch.linspace(0, 1, photos.shape[-2]).to(photos).view(1, 1, -1, 1)
        columns = torch.linspace(0, 1, photos.shape[-1]).to(photos).view(1, 1, 1, -1)
        glow = photos.new_zeros(len(photos), 1, *photos.shape[-2:])
        for _ in range(_LAMPS):
            y, x, radius = _drawn(photos, 0.0, 0.6), _drawn(photos, 0.0, 1.0), _drawn(photos, 0.03, 0.3)
            lit = (_drawn(photos, 0.0, 1.0) < 0.6).to(photos)
            glow = glow + lit * torch.exp(-((rows - y) ** 2 + (columns - x) ** 2) / (2 * radius**2))
        return glow


class Fog(Sometimes):
    """Fog, haze or dazzle: everything fades towards one light grey, more so where a street is farthest away."""

    def changed(self, photos: Photos) -> Photos:
        """Photos as of a foggy day."""
        rows = torch.linspace(0, 1, photos.shape[-2]).to(photos).view(1, 1, -1, 1)
        horizon, depth = _drawn(photos, 0.3, 0.6), _drawn(photos, 0.2, 0.6)
        thick = _drawn(photos, 0.4, 0.9) * torch.exp(-(((rows - horizon) / depth) ** 2))
        return torch.lerp(photos, _drawn(photos, 0.6, 0.95), thick.expand_as(photos[:, :1]))


class LowResolution(Sometimes):
    """Some photos come as thumbnails: shrink each to a random size and blow it up again.

    Args:
        p: the fraction of photos it happens to.
        smallest: least factor that a photo is shrunk by.
        largest: greatest.
    """

    def __init__(self, *, p: float = 0.3, smallest: float = 0.15, largest: float = 0.6) -> None:
        super().__init__(p=p)
        self.smallest, self.largest = smallest, largest

    def changed(self, photos: Photos) -> Photos:
        """Photos as of a poor camera."""
        size, out = photos.shape[-2:], torch.empty_like(photos)
        for number in range(len(photos)):  # one by one: each has a size of its own
            factor = float(torch.empty(1).uniform_(self.smallest, self.largest))
            small = [max(8, int(side * factor)) for side in size]
            coarse = F.interpolate(photos[number : number + 1], size=small, mode="bilinear", antialias=True)
            out[number] = F.interpolate(coarse, size=size, mode="bilinear")[0]
        return out


class OneByOne(nn.Module):
    """For each photo one of several changes, and what it draws for that photo alone."""

    def __init__(self, *changes: nn.Module) -> None:
        super().__init__()
        self.changes = nn.ModuleList(changes)

    def forward(self, photos: Photos) -> Photos:
        """Change each photo in its own way."""
        out = photos.clone()
        for number, which in enumerate(torch.randint(len(self.changes), (len(photos),)).tolist()):
            out[number] = self.changes[which](photos[number : number + 1])[0]
        return out


def _drawn(photos: Photos, low: float, high: float) -> Float[Tensor, "batch 1 1 1"]:
    """A number for each photo, drawn on the processor so that every device sees the same."""
    return (low + (high - low) * torch.rand(len(photos), 1, 1, 1)).to(photos)


def _kornia() -> Any:
    with needs_extra("training", "train"):
        from kornia import augmentation
    return augmentation
