"""Night and fog, as they change a street: a few lines each, drawn afresh for every photo they fall on."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

Photos = Float[Tensor, "batch 3 height width"]

_LUMA = (0.299, 0.587, 0.114)  # how bright red, green and blue look
_LAMPS = 3  # most street lamps in a photo


class Sometimes(nn.Module):
    """A change that happens to a random share of the photos; the others stay as they are.

    Args:
        p: the share, 0..1.
    """

    def __init__(self, *, p: float) -> None:
        super().__init__()
        self.p = p

    def forward(self, photos: Photos) -> Photos:
        """Change a random share of the photos."""
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
        lit = faded * torch.cat(warm, dim=1) * (1 + _lamps(photos) * _drawn(photos, 0.5, 3.0))
        noise = torch.randn(photos.shape).to(photos) * _drawn(photos, 0.0, 0.06)
        return (lit + noise).clamp(0, 1)


class Fog(Sometimes):
    """Fog, haze or dazzle: everything fades towards one light grey, more so where a street is farthest away."""

    def changed(self, photos: Photos) -> Photos:
        """Photos as of a foggy day."""
        rows = torch.linspace(0, 1, photos.shape[-2]).to(photos).view(1, 1, -1, 1)
        horizon, depth = _drawn(photos, 0.3, 0.6), _drawn(photos, 0.2, 0.6)
        thick = _drawn(photos, 0.4, 0.9) * torch.exp(-(((rows - horizon) / depth) ** 2))
        return torch.lerp(photos, _drawn(photos, 0.6, 0.95), thick.expand_as(photos[:, :1]))


def _lamps(photos: Photos) -> Float[Tensor, "batch 1 height width"]:
    """Up to three round glows in the upper half of each photo, 0..1 each."""
    rows = torch.linspace(0, 1, photos.shape[-2]).to(photos).view(1, 1, -1, 1)
    columns = torch.linspace(0, 1, photos.shape[-1]).to(photos).view(1, 1, 1, -1)
    glow = photos.new_zeros(len(photos), 1, *photos.shape[-2:])
    for _ in range(_LAMPS):
        high, aside, wide = _drawn(photos, 0.0, 0.6), _drawn(photos, 0.0, 1.0), _drawn(photos, 0.03, 0.3)
        lit = (_drawn(photos, 0.0, 1.0) < 0.6).to(photos)
        glow = glow + lit * torch.exp(-((rows - high) ** 2 + (columns - aside) ** 2) / (2 * wide**2))
    return glow


def _drawn(photos: Photos, low: float, high: float) -> Float[Tensor, "batch 1 1 1"]:
    """A number for each photo, drawn on the processor so that every device sees the same."""
    return (low + (high - low) * torch.rand(len(photos), 1, 1, 1)).to(photos)
