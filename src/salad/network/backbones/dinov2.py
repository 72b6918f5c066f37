"""DINOv2's vision transformer: pixels -> tokens.

Names are DINOv2's own, so its published files load key by key. Source: Oquab et al., "DINOv2: Learning Robust
Visual Features without Supervision" (2023), and Darcet et al., "Vision Transformers Need Registers" (2023).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.backbones.base import Backbone
from salad.network.config import ViTConfig
from salad.network.tokens import Tokens

EPS = 1e-6  # of every LayerNorm
OFFSET = 0.1  # DINOv2 resamples positions by (grid + 0.1) / 37; published weights were trained with it


class Attention(nn.Module):
    """Multi-head self-attention; query, key and value come from one layer."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Float[Tensor, "batch t d"]) -> Float[Tensor, "batch t d"]:
        """Let every token look at all."""
        batch, tokens, width = x.shape
        # Published weights hold all queries first, then all keys, then all values, each head after head.
        qkv = self.qkv(x).view(batch, tokens, 3, self.heads, width // self.heads)
        query, key, value = qkv.permute(2, 0, 3, 1, 4)
        # Fused: the matrix of every token by every other is not held where the device has such a kernel.
        mixed = F.scaled_dot_product_attention(query, key, value)
        out: Tensor = self.proj(mixed.transpose(1, 2).reshape(batch, tokens, width))
        return out


class Mlp(nn.Module):
    """Two layers with an exact GELU between them, four times as wide inside."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, 4 * width)
        self.fc2 = nn.Linear(4 * width, width)

    def forward(self, x: Float[Tensor, "*batch d"]) -> Float[Tensor, "*batch d"]:
        """Transform each token by itself."""
        out: Tensor = self.fc2(F.gelu(self.fc1(x)))
        return out


class SwiGLU(nn.Module):
    """The giant model's perceptron: a gated hidden layer, gate and value in one matrix, gate first."""

    def __init__(self, width: int) -> None:
        super().__init__()
        # Two thirds as wide, for two matrices do the work of one; in eights, as the published weights are.
        hidden = -(-int(4 * width * 2 / 3) // 8) * 8
        self.w12 = nn.Linear(width, 2 * hidden)
        self.w3 = nn.Linear(hidden, width)

    def forward(self, x: Float[Tensor, "*batch d"]) -> Float[Tensor, "*batch d"]:
        """Transform each token by itself."""
        gate, value = self.w12(x).chunk(2, dim=-1)
        out: Tensor = self.w3(F.silu(gate) * value)
        return out


class LayerScale(nn.Module):
    """One learnt factor a channel, on what a block adds to its tokens."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(width))

    def forward(self, x: Float[Tensor, "*batch d"]) -> Float[Tensor, "*batch d"]:
        """Scale each channel."""
        return x * self.gamma


class Block(nn.Module):
    """Attention, then a perceptron; each normalised before, scaled after and added on."""

    def __init__(self, config: ViTConfig) -> None:
        super().__init__()
        width = config.width
        self.norm1 = nn.LayerNorm(width, eps=EPS)
        self.attn = Attention(width, config.heads)
        self.ls1 = LayerScale(width)
        self.norm2 = nn.LayerNorm(width, eps=EPS)
        self.mlp = SwiGLU(width) if config.swiglu else Mlp(width)
        self.ls2 = LayerScale(width)

    def forward(self, x: Float[Tensor, "batch t d"]) -> Float[Tensor, "batch t d"]:
        """Pass the tokens on, a little wiser."""
        x = x + self.ls1(self.attn(self.norm1(x)))
        out: Tensor = x + self.ls2(self.mlp(self.norm2(x)))
        return out


class PatchEmbed(nn.Module):
    """Each patch of pixels -> one token."""

    def __init__(self, width: int, patch: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, kernel_size=patch, stride=patch)

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch d rows columns"]:
        """Cut and project."""
        out: Tensor = self.proj(images)
        return out


class ViT(Backbone):
    """DINOv2's vision transformer, small to giant, with or without registers.

    Raises:
        ModelError: If `heads` is not at least 1, or does not divide `width`.
    """

    def __init__(self, config: ViTConfig) -> None:
        super().__init__()
        if config.heads < 1 or config.width % config.heads:
            raise ModelError(
                f"{config.heads} attention heads do not divide a width of {config.width}; give heads= as the "
                "model was trained with"
            )
        self.config, self.width, self.stride = config, config.width, config.patch
        # `mask_token`, which only pretraining needs, is left out: `checkpoints` drops it from published files.
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + config.grid**2, config.width))
        if config.registers:
            self.register_tokens = nn.Parameter(torch.zeros(1, config.registers, config.width))
        self.patch_embed = PatchEmbed(config.width, config.patch)
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.depth))
        self.norm = nn.LayerNorm(config.width, eps=EPS)
        self._init_weights()

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised photos into tokens; both sides are multiples of the patch."""
        embedded = self.patch_embed(images)
        grid = (embedded.shape[2], embedded.shape[3])
        x = self._with_positions(embedded.flatten(2).transpose(1, 2), grid)
        for block in self.blocks:
            x = block(x)
        x = self.norm(x)  # of every token: aggregators take patches and cls token from one scale
        return Tokens(x[:, 1 + self.config.registers :], x[:, 0], grid, self.stride)

    def blocks_in_order(self) -> list[list[nn.Module]]:
        """The transformer's blocks."""
        return [[block] for block in self.blocks]

    def train_last(self, blocks: int) -> None:
        """Leave only the last `blocks` blocks and the final norm to be trained; the stem never is."""
        super().train_last(blocks)
        # As the paper trains it: patches are cut and placed as DINOv2 learnt to, with all blocks too.
        for name, weight in self.named_parameters():
            if not name.startswith("blocks."):
                weight.requires_grad_(blocks > 0 and name.startswith("norm."))

    def _with_positions(self, patches: Tensor, grid: tuple[int, int]) -> Tensor:
        first, rest = self.pos_embed[:, :1], self._positions(grid)
        batch = patches.shape[0]  # and not its len: an exported graph would hold the example's for ever
        parts = [(self.cls_token + first).expand(batch, -1, -1)]
        # Registers stand between cls token and patches and have no position: they are nowhere in the photo.
        if self.config.registers:
            parts.append(self.register_tokens.expand(batch, -1, -1))
        return torch.cat([*parts, patches + rest.to(patches.dtype)], dim=1)

    def _positions(self, grid: tuple[int, int]) -> Float[Tensor, "1 n d"]:
        """The learnt positions, resampled to `grid` just as the published models do."""
        side = self.config.grid
        learnt = self.pos_embed[:, 1:]
        if grid == (side, side):
            return learnt
        square = learnt.view(1, side, side, -1).permute(0, 3, 1, 2)
        # The two families were trained with different resampling, and each wants its own: with the other's, tokens
        # of a photo of 322 pixels are not those that published heads were trained on.
        if self.config.registers:
            resampled = F.interpolate(square, size=grid, mode="bicubic", antialias=True)
        else:
            # By factors and not by the size, which comes to the same grid but to other weights of the bicubic kernel.
            factors = tuple((cells + OFFSET) / side for cells in grid)
            resampled = F.interpolate(square, scale_factor=factors, mode="bicubic", antialias=False)
        return resampled.flatten(2).transpose(1, 2)

    def _init_weights(self) -> None:
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.trunc_normal_(module.weight, std=0.02)
                nn.init.zeros_(module.bias)
