"""What SALAD is compared with: each aggregator against its paper's formula in plain loops, and what all must keep."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from beartype import beartype
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped
from torch import Tensor, nn

from salad.errors import ModelError
from salad.network.aggregator_config import AggregatorConfig, RouteConfig, SaladConfig
from salad.network.aggregators.base import build_aggregator
from salad.network.aggregators.netvlad import NetVlad
from salad.network.aggregators.pooling import Gem
from salad.network.aggregators.salad_layout import Route
from salad.network.aggregators.vlad import Vlad
from salad.network.baseline_config import (
    AverageConfig,
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    GemConfig,
    MixVprConfig,
    NetVladConfig,
    SceneConfig,
    VladConfig,
)
from salad.network.tokens import Tokens

GRID = (4, 6)
SALAD = SaladConfig(5, clusters=3, cluster_dim=4, scene_dim=2, hidden=6)
CASES: dict[str, AggregatorConfig] = {
    "salad": SALAD,
    "no dustbin": dataclasses.replace(SALAD, dustbin=False),
    "no scene": dataclasses.replace(SALAD, scene_dim=0, linear=7),
    "softmax": dataclasses.replace(SALAD, transport="softmax"),
    "dual softmax": dataclasses.replace(SALAD, transport="dual-softmax"),
    "scene": SceneConfig(5),
    "average": AverageConfig(5),
    "gem": GemConfig(5),
    "learned gem": GemConfig(5, learned=True),
    "netvlad": NetVladConfig(5, clusters=3),
    "netvlad linear": NetVladConfig(5, clusters=3, linear=4),
    "vlad": VladConfig(5, clusters=3),
    "mixvpr": MixVprConfig(5, grid=GRID, depth=2, ratio=2, channels=3, rows=2),
    "conv-ap": ConvApConfig(5, channels=3, grid=(2, 3)),
    "cosplace": CosPlaceConfig(5, linear=4),
    "boq": BoqConfig(5, channels=4, queries=3, blocks=2, rows=2, heads=2),
    "route": RouteConfig(5, salad=SALAD, grid=2, cell_dim=3, weight=0.7),
}
PLACELESS = [name for name in CASES if name not in {"mixvpr", "conv-ap", "route"}]  # blind to where a token is
DEAF = {"scene", "average", "gem", "vlad"}  # nothing to train


def _build(config: AggregatorConfig, *, seed: int = 0) -> Any:
    """Random weights everywhere, biases and vocabularies too, in float64."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        made = build_aggregator(config).double().eval()
        for weight in made.parameters():
            if weight.ndim:
                weight.data += 0.3 * torch.randn_like(weight)
        if isinstance(made, Vlad):
            words = torch.randn(config.clusters, config.width)
            made.start_from(words / words.norm(dim=1, keepdim=True), words)
    return made


def _tokens(batch: int = 2, *, seed: int = 0, grid: tuple[int, int] = GRID, width: int = 5) -> Tokens:
    made = torch.Generator().manual_seed(seed)
    patches = torch.randn(batch, grid[0] * grid[1], width, generator=made, dtype=torch.float64)
    scene = torch.randn(batch, width, generator=made, dtype=torch.float64)
    return Tokens(patches, scene, grid, 16)


def _unit(values: Tensor) -> Tensor:
    return values / values.norm()


# --- what all must keep --------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_a_descriptor_has_length_one_and_the_width_it_says(name: str) -> None:
    model = _build(CASES[name])
    out = jaxtyped(typechecker=beartype)(model.forward)(_tokens(3))
    assert out.shape == (3, model.dim) == (3, CASES[name].dim)
    torch.testing.assert_close(out.norm(dim=1), torch.ones(3, dtype=torch.float64))


@pytest.mark.parametrize("name", CASES)
@torch.no_grad()
def test_one_photo_alone_is_its_row_in_a_batch(name: str) -> None:
    model, tokens = _build(CASES[name]), _tokens(4)
    together = model(tokens)
    for row in range(4):
        alone = tokens._replace(patches=tokens.patches[row : row + 1], cls=tokens.cls[row : row + 1])
        torch.testing.assert_close(model(alone)[0], together[row])


@pytest.mark.parametrize("name", PLACELESS)
@torch.no_grad()
def test_the_order_of_the_patches_does_not_matter(name: str) -> None:
    model, tokens = _build(CASES[name]), _tokens()
    order = torch.randperm(24, generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(model(tokens._replace(patches=tokens.patches[:, order])), model(tokens))


@pytest.mark.parametrize("name", sorted(CASES.keys() - set(PLACELESS)))
@torch.no_grad()
def test_where_a_patch_is_matters_to_the_others(name: str) -> None:
    model, tokens = _build(CASES[name]), _tokens()
    turned = tokens._replace(patches=tokens.patches.flip(1))
    assert float((model(turned) - model(tokens)).abs().max()) > 1e-3


@pytest.mark.parametrize("name", sorted(CASES.keys() - DEAF))
def test_gradients_are_right(name: str) -> None:
    model, tokens = _build(CASES[name]), _tokens()
    tokens = tokens._replace(patches=tokens.patches.abs() + 0.1)  # away from where a power has no slope
    inputs = [tokens.patches.requires_grad_(), tokens.cls.requires_grad_(), *model.parameters()]

    def describe(patches: Tensor, scene: Tensor, *_: Tensor) -> Tensor:
        out: Tensor = model(Tokens(patches, scene, GRID, 16))
        return out

    assert torch.autograd.gradcheck(describe, inputs, fast_mode=True)


@pytest.mark.parametrize("name", sorted(DEAF))
def test_what_is_not_trained_has_no_weight(name: str) -> None:
    assert list(_build(CASES[name]).parameters()) == []


CANCELLED = {  # a constant on a row of scores, which the first half of a Sinkhorn round takes away again
    "salad": {"dustbin", "score.3.bias"},
    "no dustbin": {"score.3.bias"},
    "no scene": {"dustbin", "score.3.bias"},
    "route": {"salad.dustbin", "salad.score.3.bias"},
}


@pytest.mark.parametrize("name", sorted(CASES.keys() - DEAF))
def test_every_weight_counts_but_what_sinkhorn_cancels(name: str) -> None:
    model = _build(CASES[name], seed=1)
    out = model(_tokens())
    to = torch.randn(out.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    (out * to).sum().backward()
    slopes = {key: weight.grad for key, weight in model.named_parameters()}
    without = {key for key, slope in slopes.items() if slope is not None and float(slope.abs().max()) < 1e-12}
    assert without == CANCELLED.get(name, set())
    assert all(slope is not None for slope in slopes.values())


# --- by hand -------------------------------------------------------------------------------


def _residuals_by_hand(units: Tensor, weights: Tensor, centroids: Tensor) -> Tensor:
    sums = torch.zeros(len(centroids), units.shape[1], dtype=torch.float64)
    for token, shares in zip(units, weights, strict=True):
        for cluster, centroid in enumerate(centroids):
            sums[cluster] += shares[cluster] * (token - centroid)
    return _unit(torch.stack([_unit(one) for one in sums]).flatten())


@torch.no_grad()
def test_netvlad_is_its_sum_over_tokens_and_centroids() -> None:
    plain, linear = _build(CASES["netvlad"]), _build(CASES["netvlad linear"])
    assert isinstance(plain, NetVlad)
    assert isinstance(linear, NetVlad)
    tokens = _tokens()
    for model in (plain, linear):
        for row, patches in enumerate(tokens.patches):
            units = torch.stack([_unit(token) for token in patches])
            scores = torch.stack([model.score.weight @ token + model.score.bias for token in units])
            shares = scores.exp() / scores.exp().sum(dim=1, keepdim=True)
            expected = _residuals_by_hand(units, shares, model.centroids)
            if model.linear is not None:
                expected = _unit(model.linear.weight @ expected + model.linear.bias)
            torch.testing.assert_close(model(tokens)[row], expected)


@torch.no_grad()
def test_vlad_gives_each_token_to_the_nearest_word() -> None:
    model, tokens = _build(CASES["vlad"]), _tokens()
    assert isinstance(model, Vlad)
    for row, patches in enumerate(tokens.patches):
        units = torch.stack([_unit(token) for token in patches])
        nearest = [min(range(3), key=lambda word: float((unit - model.vocabulary[word]).norm())) for unit in units]
        belongs = torch.tensor([[float(word == of) for word in range(3)] for of in nearest])
        assert len(set(nearest)) > 1
        torch.testing.assert_close(model(tokens)[row], _residuals_by_hand(units, belongs, model.vocabulary))


def test_vlad_without_a_vocabulary_says_how_to_make_one() -> None:
    with pytest.raises(ModelError, match=r"no vocabulary yet: make one .* 'salad weights vocabulary'"):
        build_aggregator(VladConfig(5))(_tokens())


@settings(max_examples=20)
@given(st.integers(2, 6), st.integers(0, 2**32 - 1))
@torch.no_grad()
def test_netvlad_starts_a_hundred_times_surer_of_the_nearest(clusters: int, seed: int) -> None:
    made = torch.Generator().manual_seed(seed)
    units = torch.nn.functional.normalize(torch.randn(60, 5, generator=made, dtype=torch.float64), dim=1)
    centroids = units[:clusters] * 0.8
    model = NetVlad(NetVladConfig(5, clusters=clusters)).double()
    model.start_from(centroids, units)
    shares = model.score(units).softmax(dim=1)
    near = torch.cdist(units, centroids)
    assert bool((shares.argmax(dim=1) == near.argmin(dim=1)).all())
    first, second = shares.sort(dim=1, descending=True).values[:, :2].T
    assert float((first / second).log().mean()) == pytest.approx(math.log(100), rel=1e-6)
    torch.testing.assert_close(model.centroids.data, centroids)
    assert bool(model.fitted)


@torch.no_grad()
def test_one_centroid_can_be_started_too() -> None:
    model = NetVlad(NetVladConfig(3, clusters=1))
    model.start_from(torch.tensor([[0.0, 0.6, 0.8]]), torch.eye(3))
    torch.testing.assert_close(model.score(torch.eye(3)).softmax(dim=1), torch.ones(3, 1))


@settings(max_examples=20)
@given(st.floats(0.5, 12))
@torch.no_grad()
def test_learned_gem_is_the_mean_of_powers_and_one_is_the_average(power: float) -> None:
    tokens = _tokens()
    tokens = tokens._replace(patches=tokens.patches.abs() + 0.01)
    model = Gem(GemConfig(5, power=power, learned=True)).double()
    for row, patches in enumerate(tokens.patches):
        means = [(sum(float(x) ** power for x in channel) / 24) ** (1 / power) for channel in patches.T]
        expected = _unit(torch.tensor(means, dtype=torch.float64))
        torch.testing.assert_close(model(tokens)[row], expected, rtol=1e-5, atol=1e-7)
    average = build_aggregator(AverageConfig(5))
    torch.testing.assert_close(Gem(GemConfig(5, power=1, learned=True)).double()(tokens), average(tokens))


@torch.no_grad()
def test_the_average_keeps_what_is_below_zero() -> None:
    tokens = Tokens(torch.tensor([[[3.0, -1.0], [3.0, -7.0]]]), torch.zeros(1, 2), (1, 2), 16)
    torch.testing.assert_close(build_aggregator(AverageConfig(2))(tokens), torch.tensor([[0.6, -0.8]]))


@torch.no_grad()
def test_cosplace_is_gem_and_a_linear_layer() -> None:
    model: Any = _build(CASES["cosplace"])
    tokens = _tokens()
    pooled = tokens.patches.clamp(min=1e-6).pow(3).mean(dim=1).pow(1 / 3)
    for row in range(2):
        torch.testing.assert_close(model(tokens)[row], _unit(model.linear.weight @ pooled[row] + model.linear.bias))


@torch.no_grad()
def test_mixvpr_mixes_each_channel_across_its_cells() -> None:
    model: Any = _build(CASES["mixvpr"])
    tokens = _tokens()
    for row, patches in enumerate(tokens.patches):
        maps = list(patches.T)
        for mixer in model.mixers:
            norm, wide, _, narrow = mixer.mix
            for number, cells in enumerate(maps):
                level = (cells - cells.mean()) / (cells.var(unbiased=False) + norm.eps).sqrt()
                hidden = (wide.weight @ (level * norm.weight + norm.bias) + wide.bias).clamp(min=0)
                maps[number] = cells + narrow.weight @ hidden + narrow.bias
        kept = model.channels.weight @ torch.stack(maps) + model.channels.bias[:, None]
        expected = torch.stack([model.rows.weight @ channel + model.rows.bias for channel in kept])
        torch.testing.assert_close(model(tokens)[row], _unit(expected.flatten()))


@pytest.mark.parametrize("grid", [(4, 5), (6, 4), (2, 12), (8, 12)])
def test_mixvpr_names_the_size_that_works(grid: tuple[int, int]) -> None:
    said = rf"gives {grid[0]} x {grid[1]} tokens, .* mixes 4 x 6; use images 64 pixels high and 96 wide"
    with pytest.raises(ModelError, match=said):
        _build(CASES["mixvpr"])(_tokens(grid=grid))


@torch.no_grad()
def test_conv_ap_averages_where_things_are() -> None:
    model: Any = _build(CASES["conv-ap"])
    tokens = _tokens()
    for row, patches in enumerate(tokens.patches):
        maps = torch.stack([model.channels.weight @ token + model.channels.bias for token in patches]).T
        maps = maps.reshape(3, 4, 6)
        cells = [
            maps[channel, 2 * high : 2 * high + 2, 2 * wide : 2 * wide + 2].mean()
            for channel in range(3)
            for high in range(2)
            for wide in range(3)
        ]
        torch.testing.assert_close(model(tokens)[row], _unit(torch.stack(cells)))


def _attend(module: nn.MultiheadAttention, asks: Tensor, told: Tensor) -> Tensor:
    """Attention of one photo, head by head."""
    width = asks.shape[1]
    weights, biases = module.in_proj_weight, module.in_proj_bias
    query, key, value = (
        x @ weights[at * width : (at + 1) * width].T + biases[at * width : (at + 1) * width]
        for at, x in enumerate((asks, told, told))
    )
    each, mixed = width // module.num_heads, []
    for head in range(module.num_heads):
        part = slice(head * each, (head + 1) * each)
        scores = query[:, part] @ key[:, part].T / math.sqrt(each)
        mixed.append(scores.softmax(dim=1) @ value[:, part])
    return torch.cat(mixed, dim=1) @ module.out_proj.weight.T + module.out_proj.bias


@torch.no_grad()
def test_boq_asks_its_queries_after_each_layer() -> None:
    model: Any = _build(CASES["boq"])
    tokens = _tokens()
    for row, patches in enumerate(tokens.patches):
        x, answers = model.narrow(patches), []
        for block in model.blocks:
            layer, queries = block.encoder, block.queries[0]
            x = layer.norm1(x + _attend(layer.self_attn, x, x))
            x = layer.norm2(x + layer.linear2(layer.linear1(x).clamp(min=0)))
            asked = block.norm_queries(queries + _attend(block.among, queries, queries))
            answers.append(block.norm_answers(_attend(block.across, asked, x)))
        kept = torch.cat(answers).T @ model.rows.weight.T + model.rows.bias
        torch.testing.assert_close(model(tokens)[row], _unit(kept.flatten()))


@torch.no_grad()
def test_the_order_of_boqs_queries_does_not_matter() -> None:
    model: Any = _build(CASES["boq"])
    expected = model(_tokens())
    order = torch.tensor([2, 0, 1])
    for number, block in enumerate(model.blocks):
        block.queries.data = block.queries.data[:, order]
        columns = slice(3 * number, 3 * number + 3)
        model.rows.weight.data[:, columns] = model.rows.weight.data[:, columns][:, order]
    torch.testing.assert_close(model(_tokens()), expected)


# --- the layout part -----------------------------------------------------------------------


@torch.no_grad()
def test_a_route_is_salad_beside_a_weighted_layout() -> None:
    model = _build(CASES["route"])
    assert isinstance(model, Route)
    tokens = _tokens()
    found, length = model(tokens), math.sqrt(1 + 0.7**2)
    torch.testing.assert_close(found[:, : SALAD.dim], model.salad(tokens) / length)
    for row, patches in enumerate(tokens.patches):
        maps, cells = patches.reshape(4, 6, 5), []
        for high in range(2):
            for wide in range(2):
                pooled = maps[2 * high : 2 * high + 2, 3 * wide : 3 * wide + 3].mean(dim=(0, 1))
                cells.append(_unit(model.cell.weight @ pooled + model.cell.bias))
        torch.testing.assert_close(found[row, SALAD.dim :], 0.7 * _unit(torch.cat(cells)) / length)


@torch.no_grad()
def test_a_layout_that_weighs_nothing_leaves_salad() -> None:
    config = dataclasses.replace(CASES["route"], weight=0)
    model = _build(config)
    assert isinstance(model, Route)
    torch.testing.assert_close(model(_tokens())[:, : SALAD.dim], model.salad(_tokens()))
    assert float(model(_tokens())[:, SALAD.dim :].abs().max()) == 0


@torch.no_grad()
def test_a_mirrored_photo_is_another_layout_and_the_same_salad() -> None:
    model, tokens = _build(CASES["route"]), _tokens()
    assert isinstance(model, Route)
    mirrored = tokens._replace(patches=tokens.patches.reshape(2, 4, 6, 5).flip(2).reshape(2, 24, 5))
    torch.testing.assert_close(model.salad(mirrored), model.salad(tokens))
    cells = model.layout(tokens).reshape(2, 2, 2, 3)
    torch.testing.assert_close(model.layout(mirrored).reshape(2, 2, 2, 3), cells.flip(2))
