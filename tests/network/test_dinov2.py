"""The vision transformer: shapes, positions, what is trained."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from beartype import beartype
from jaxtyping import jaxtyped
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.backbones.dinov2 import Block, SwiGLU, ViT
from salad.network.config import VITS, ViTConfig

TINY = ViTConfig(width=16, depth=3, heads=2, grid=5)


def _vit(config: ViTConfig = TINY, seed: int = 0) -> ViT:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return ViT(config).eval()


def _images(batch: int, height: int, width: int) -> torch.Tensor:
    return torch.randn(batch, 3, height, width, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("registers", [0, 4])
@pytest.mark.parametrize("swiglu", [False, True])
@pytest.mark.parametrize("grid", [(3, 3), (5, 5), (2, 7)])
def test_tokens_have_the_shapes_they_say(registers: int, swiglu: bool, grid: tuple[int, int]) -> None:
    model = _vit(dataclasses.replace(TINY, registers=registers, swiglu=swiglu))
    tokens = jaxtyped(typechecker=beartype)(model.forward)(_images(2, grid[0] * 14, grid[1] * 14))
    assert tokens.patches.shape == (2, grid[0] * grid[1], 16)
    assert tokens.cls.shape == (2, 16)
    assert (tokens.grid, tokens.stride) == (grid, 14)


def test_a_patch_is_read_row_by_row() -> None:
    """Without blocks a token depends on its own pixels alone."""
    model = _vit(dataclasses.replace(TINY, depth=0))
    images = _images(1, 28, 42)
    before = model(images).patches
    images[:, :, 14:, 28:] += 1  # the last patch of the second row
    changed = (model(images).patches - before).abs().sum(dim=2)[0] > 1e-6
    assert changed.tolist() == [False] * 5 + [True]


def test_positions_are_as_learnt_on_their_own_grid() -> None:
    model = _vit()
    assert model._positions((5, 5)).data_ptr() == model.pos_embed[:, 1:].data_ptr()
    assert not torch.equal(model(_images(1, 70, 70)).cls, _vit(seed=1)(_images(1, 70, 70)).cls)


def test_positions_are_resampled_without_antialias_and_with_the_offset() -> None:
    """Bicubic weights written out here: cells of the new grid looked up at (i + 0.5) * 5 / (g + 0.1) - 0.5."""
    model = _vit()
    learnt = model.pos_embed.detach()[0, 1:].view(5, 5, 16).double()

    def weights(cells: int) -> torch.Tensor:
        rows = torch.zeros(cells, 5, dtype=torch.float64)
        for cell in range(cells):
            where = (cell + 0.5) * 5 / (cells + 0.1) - 0.5
            first = int(where // 1)
            for tap in range(first - 1, first + 3):
                x, a = abs(where - tap), -0.75
                inner = (a + 2) * x**3 - (a + 3) * x**2 + 1
                weight = inner if x <= 1 else a * (x**3 - 5 * x**2 + 8 * x - 4)
                rows[cell, min(max(tap, 0), 4)] += weight
        return rows

    expected = torch.einsum("ai,bj,ijd->abd", weights(3), weights(7), learnt).reshape(1, 21, 16)
    torch.testing.assert_close(model._positions((3, 7)).detach().double(), expected, rtol=0, atol=1e-6)


def test_positions_beside_registers_are_resampled_to_the_exact_size_with_antialias() -> None:
    model = _vit(dataclasses.replace(TINY, registers=4))
    square = model.pos_embed.detach()[:, 1:].view(1, 5, 5, 16).permute(0, 3, 1, 2)
    expected = F.interpolate(square, size=(3, 7), mode="bicubic", antialias=True)
    torch.testing.assert_close(model._positions((3, 7)).detach(), expected.flatten(2).transpose(1, 2))


def test_registers_take_part_and_are_dropped() -> None:
    model = _vit(dataclasses.replace(TINY, registers=4))
    images = _images(1, 42, 42)
    before = model(images)
    assert before.patches.shape[1] == 9
    model.register_tokens.data += torch.randn(1, 4, 16, generator=torch.Generator().manual_seed(2))
    assert not torch.allclose(model(images).patches, before.patches)


@pytest.mark.parametrize("blocks", [0, 1, 2, 3])
def test_train_last_trains_exactly_the_last_blocks_and_the_norm(blocks: int) -> None:
    model = _vit()
    model.train_last(blocks)
    trained = {name for name, weight in model.named_parameters() if weight.requires_grad}
    wanted = (*(f"blocks.{number}." for number in range(3 - blocks, 3)), "norm.")
    assert trained == {name for name, _ in model.named_parameters() if blocks and name.startswith(wanted)}
    if blocks:
        model(_images(1, 42, 42)).patches.sum().backward()
        assert {name for name, weight in model.named_parameters() if weight.grad is not None} == trained


@pytest.mark.parametrize("blocks", [-1, 4])
def test_more_blocks_than_there_are_cannot_be_trained(blocks: int) -> None:
    with pytest.raises(ModelError, match=f"trained_blocks is {blocks}, but this backbone has 3"):
        _vit().train_last(blocks)


@pytest.mark.parametrize("heads", [3, 0, -2])
def test_heads_must_divide_the_width(heads: int) -> None:
    with pytest.raises(ModelError, match="heads"):
        ViT(dataclasses.replace(TINY, heads=heads))


def test_swiglu_by_hand_gate_first() -> None:
    layer = SwiGLU(12)
    hidden = layer.w3.in_features
    assert hidden == 32  # 8 * ceil(int(4 * 12 * 2 / 3) / 8)
    assert SwiGLU(1536).w3.in_features == 4096
    x = torch.randn(2, 12, generator=torch.Generator().manual_seed(0))
    both = x @ layer.w12.weight.T + layer.w12.bias
    gate, value = both[:, :hidden], both[:, hidden:]
    expected = (gate / (1 + torch.exp(-gate)) * value) @ layer.w3.weight.T + layer.w3.bias
    torch.testing.assert_close(layer(x), expected)


def test_a_block_by_hand() -> None:
    """Attention written out head by head, LayerScale, exact GELU, eps 1e-6."""
    torch.manual_seed(3)
    block = Block(TINY).double().eval()
    block.ls1.gamma.data.uniform_(0.5, 1.5)
    block.ls2.gamma.data.uniform_(0.5, 1.5)
    x = torch.randn(1, 5, 16, dtype=torch.float64)

    def norm(t: torch.Tensor, layer: torch.nn.LayerNorm) -> torch.Tensor:
        centred = t - t.mean(-1, keepdim=True)
        return centred / (centred.pow(2).mean(-1, keepdim=True) + 1e-6).sqrt() * layer.weight + layer.bias

    normed = norm(x, block.norm1)[0]
    query, key, value = (normed @ block.attn.qkv.weight.T + block.attn.qkv.bias).split(16, dim=1)
    heads = []
    for head in (slice(0, 8), slice(8, 16)):
        attention = torch.softmax(query[:, head] @ key[:, head].T / 8**0.5, dim=1)
        heads.append(attention @ value[:, head])
    mixed = torch.cat(heads, dim=1) @ block.attn.proj.weight.T + block.attn.proj.bias
    after = x + mixed * block.ls1.gamma
    inside = norm(after, block.norm2) @ block.mlp.fc1.weight.T + block.mlp.fc1.bias
    inside = inside * 0.5 * (1 + torch.erf(inside / 2**0.5))
    expected = after + (inside @ block.mlp.fc2.weight.T + block.mlp.fc2.bias) * block.ls2.gamma
    torch.testing.assert_close(block(x), expected)


@pytest.mark.parametrize(
    ("name", "millions"), [("vits14", 22.1), ("vitb14", 86.6), ("vitl14", 304.4), ("vitg14", 1136.5)]
)
def test_the_four_sizes_have_as_many_weights_as_dinov2_says(name: str, millions: float) -> None:
    with torch.device("meta"):
        model = ViT(VITS[name])
    assert sum(weight.numel() for weight in model.parameters()) / 1e6 == pytest.approx(millions, abs=0.06)
