"""The aggregators: order of a descriptor, gradients, memory, and the plain baselines by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from beartype import beartype
from jaxtyping import jaxtyped
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from salad.errors import TooFewTokensError
from salad.network.aggregator_config import PRESETS, SaladConfig
from salad.network.aggregators.base import build_aggregator
from salad.network.aggregators.pooling import Gem, Scene
from salad.network.aggregators.salad import Salad
from salad.network.baseline_config import GemConfig, SceneConfig
from salad.network.tokens import Tokens

SMALL = SaladConfig(width=6, clusters=3, cluster_dim=4, scene_dim=5, hidden=7)


def _tokens(
    batch: int, rows: int, columns: int, width: int, *, dtype: torch.dtype = torch.float32, seed: int = 0
) -> Tokens:
    made = torch.Generator().manual_seed(seed)
    patches = torch.randn(batch, rows * columns, width, generator=made, dtype=dtype)
    return Tokens(patches, torch.randn(batch, width, generator=made, dtype=dtype), (rows, columns), 14)


def _salad(config: SaladConfig, seed: int = 0) -> Salad:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Salad(config).eval()


class Pick(nn.Module):
    """Some numbers of each token, as they are."""

    def __init__(self, first: int, end: int, factor: float = 1.0) -> None:
        super().__init__()
        self.first, self.end, self.factor = first, end, factor

    def forward(self, x: Tensor) -> Tensor:
        return self.factor * x[..., self.first : self.end]


class LargestTensor(TorchDispatchMode):
    """Remembers how many numbers the largest tensor has that any operation inside makes."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        made = [leaf.numel() for leaf in tree_leaves(out) if isinstance(leaf, Tensor)]
        self.numbers = max([self.numbers, *made])
        return out


def test_feature_k_of_cluster_j_is_number_g_plus_k_m_plus_j() -> None:
    m, l, g, n = 3, 4, 5, 16  # noqa: E741  # the paper's letter
    model = _salad(SaladConfig(width=m + l + g, clusters=m, cluster_dim=l, scene_dim=g), seed=1).double()
    model.score, model.feature = Pick(0, m, 3.0), Pick(m, m + l)
    model.scene = Pick(m + l, m + l + g)
    tokens = _tokens(2, 4, 4, m + l + g, dtype=torch.float64)
    found, plan = model(tokens), model.plan(tokens)
    for photo in range(2):
        expected = torch.zeros(g + l * m, dtype=torch.float64)
        expected[:g] = tokens.cls[photo, m + l :] / tokens.cls[photo, m + l :].norm()
        for j in range(m):
            volume = torch.zeros(l, dtype=torch.float64)
            for token in range(n):
                volume += plan[photo, j, token] * tokens.patches[photo, token, m : m + l]
            for k in range(l):
                expected[g + k * m + j] = volume[k] / volume.norm()
        torch.testing.assert_close(found[photo], expected / expected.norm())


def test_gradients_are_right() -> None:
    model = _salad(SMALL).double()
    tokens = _tokens(2, 2, 3, 6, dtype=torch.float64)
    inputs = [tokens.patches.requires_grad_(), tokens.cls.requires_grad_(), *model.parameters()]

    def describe(patches: Tensor, scene: Tensor, *_: Tensor) -> Tensor:
        descriptors: Tensor = model(Tokens(patches, scene, (2, 3), 14))
        return descriptors

    assert torch.autograd.gradcheck(describe, inputs)


@pytest.mark.parametrize("name", PRESETS)
def test_no_tensor_of_four_dimensions_is_built(name: str) -> None:
    config = dataclasses.replace(PRESETS[name], width=64, hidden=64)
    batch, n = 1, 529
    whole = batch * config.cluster_dim * config.clusters * n
    model, tokens = _salad(config), _tokens(batch, 23, 23, config.width)
    expected = batch * n * max(config.hidden, config.cluster_dim, config.clusters + 1)
    tokens.patches.requires_grad_()
    with LargestTensor() as seen:
        model(tokens).sum().backward()
    assert seen.numbers == expected < whole / 4


@pytest.mark.parametrize("linear", [None, 11])
def test_a_descriptor_has_length_one_and_the_width_it_says(linear: int | None) -> None:
    config = SaladConfig(width=6, clusters=3, cluster_dim=4, scene_dim=5, hidden=7, linear=linear)
    model = _salad(config)
    out = jaxtyped(typechecker=beartype)(model.forward)(_tokens(3, 3, 5, 6))
    assert out.shape == (3, model.dim) == (3, linear or 17)
    torch.testing.assert_close(out.norm(dim=1), torch.ones(3))


def test_one_photo_alone_is_its_row_in_a_batch() -> None:
    model, tokens = _salad(SMALL), _tokens(4, 3, 4, 6)
    together = model(tokens)
    for row in range(4):
        alone = Tokens(tokens.patches[row : row + 1], tokens.cls[row : row + 1], tokens.grid, tokens.stride)
        torch.testing.assert_close(model(alone)[0], together[row], rtol=0, atol=1e-5)


def test_the_order_of_the_patches_does_not_matter() -> None:
    model, tokens = _salad(SMALL), _tokens(2, 3, 4, 6)
    moved = tokens._replace(patches=tokens.patches[:, torch.randperm(12)])
    torch.testing.assert_close(model(moved), model(tokens), rtol=0, atol=1e-6)


def test_too_few_tokens_are_refused_with_the_side_that_works() -> None:
    model = _salad(PRESETS["full"])
    with pytest.raises(TooFewTokensError, match="at least 126 x 126"):
        model(_tokens(1, 8, 8, 768))
    assert model(_tokens(1, 9, 9, 768)).shape == (1, 8448)


def test_the_plan_stays_float32_under_autocast() -> None:
    model, tokens = _salad(SMALL), _tokens(2, 4, 4, 6)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        plan, descriptor = model.plan(tokens), model(tokens)
    assert plan.dtype == torch.float32
    torch.testing.assert_close(plan.sum(dim=1), torch.ones(2, 16), rtol=0, atol=1e-6)
    assert float(F.cosine_similarity(descriptor.float(), model(tokens)).detach().min()) > 0.999


def test_dropout_belongs_to_scores_and_features_in_training_alone() -> None:
    model, tokens = _salad(SMALL), _tokens(1, 4, 4, 6)
    torch.testing.assert_close(model(tokens), model(tokens), rtol=0, atol=0)
    model.train()
    torch.manual_seed(0)
    assert not torch.equal(model.plan(tokens), model.plan(tokens))
    assert not torch.equal(model.feature(tokens.patches), model.feature(tokens.patches))
    torch.testing.assert_close(model.scene(tokens.cls), model.scene(tokens.cls), rtol=0, atol=0)


def test_the_dustbin_starts_at_one() -> None:
    assert float(_salad(SMALL).dustbin.detach()) == 1.0


def test_baselines_by_hand() -> None:
    tokens = Tokens(torch.tensor([[[1.0, 2.0], [3.0, -4.0]]]), torch.tensor([[3.0, 4.0]]), (1, 2), 14)
    scene, gem = build_aggregator(SceneConfig(width=2)), build_aggregator(GemConfig(width=2, power=2.0))
    assert isinstance(scene, Scene)
    assert isinstance(gem, Gem)
    torch.testing.assert_close(scene(tokens), torch.tensor([[0.6, 0.8]]))
    mean = torch.tensor([[5.0**0.5, 2.0**0.5]])  # of squares; what is below 0 counts as 0
    torch.testing.assert_close(gem(tokens), mean / mean.norm())
    assert isinstance(build_aggregator(SMALL), Salad)
