"""SALAD's variants: softmax, dual softmax, no dustbin, no scene token, any number of rounds, by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from beartype import beartype
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import jaxtyped
from torch import Tensor
from torch.nn import functional as F

from salad.errors import TooFewTokensError
from salad.network import sinkhorn
from salad.network.aggregator_config import SaladConfig
from salad.network.aggregators.salad import Salad
from salad.network.tokens import Tokens

sinkhorn_assign, softmax, dual_softmax = (
    jaxtyped(typechecker=beartype)(each) for each in (sinkhorn.sinkhorn_assign, sinkhorn.softmax, sinkhorn.dual_softmax)
)
BASE = SaladConfig(6, clusters=3, cluster_dim=4, scene_dim=5, hidden=7)

sizes = st.tuples(st.integers(1, 3), st.integers(1, 6), st.integers(1, 12))  # batch, clusters, tokens
seeds = st.integers(0, 2**32 - 1)
dustbins = st.none() | st.floats(-3, 3)


def _scores(size: tuple[int, int, int], seed: int) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(0, 2, size))


def _bin(score: float | None) -> Tensor | None:
    return None if score is None else torch.tensor(score, dtype=torch.float64)


def _exponentials(scores: Tensor, dustbin: float | None) -> np.ndarray:
    """exp of one photo's scores, the dustbin's below them."""
    rows = [[np.exp(float(score)) for score in row] for row in scores]
    if dustbin is not None:
        rows.append([np.exp(dustbin)] * scores.shape[1])
    return np.array(rows)


def _tokens(seed: int = 0, tokens: int = 12) -> Tokens:
    made = torch.Generator().manual_seed(seed)
    return Tokens(torch.randn(2, tokens, 6, generator=made), torch.randn(2, 6, generator=made), (1, tokens), 14)


def _salad(**change: object) -> Salad:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Salad(dataclasses.replace(BASE, **change)).eval()


@given(sizes, seeds, dustbins)
def test_softmax_shares_each_token_by_itself(size: tuple[int, int, int], seed: int, dustbin: float | None) -> None:
    scores = _scores(size, seed)
    plan = softmax(scores, _bin(dustbin)).numpy()
    for photo, found in zip(scores, plan, strict=True):
        powers = _exponentials(photo, dustbin)
        np.testing.assert_allclose(found, powers / powers.sum(axis=0), rtol=1e-10)
    np.testing.assert_allclose(plan.sum(axis=1), 1)


@given(sizes, seeds, dustbins)
def test_dual_softmax_is_the_product_of_both(size: tuple[int, int, int], seed: int, dustbin: float | None) -> None:
    scores = _scores(size, seed)
    for photo, found in zip(scores, dual_softmax(scores, _bin(dustbin)).numpy(), strict=True):
        powers = _exponentials(photo, dustbin)
        expected = powers**2 / powers.sum(axis=0) / powers.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(found, expected, rtol=1e-10)


@given(sizes, seeds, st.integers(0, 30))
def test_without_a_dustbin_every_cluster_wants_its_part_of_all_tokens(
    size: tuple[int, int, int], seed: int, rounds: int
) -> None:
    scores = _scores(size, seed) / 4
    _, clusters, tokens = size
    for photo, found in zip(scores, sinkhorn_assign(scores, None, iterations=rounds).numpy(), strict=True):
        kernel = _exponentials(photo, None)
        rows, columns = np.ones(clusters), np.ones(tokens)
        for _ in range(rounds):
            rows = (tokens / clusters) / (kernel @ columns)
            columns = 1 / (kernel.T @ rows)
        np.testing.assert_allclose(found, rows[:, None] * kernel * columns, rtol=1e-8)
        if rounds:
            np.testing.assert_allclose(found.sum(axis=0), 1)
        if rounds == 30:
            np.testing.assert_allclose(found.sum(axis=1), tokens / clusters, rtol=1e-3)


def test_more_rounds_bring_every_clusters_mass_nearer_to_one() -> None:
    scores = _scores((1, 5, 30), 0)
    misses = [
        float((sinkhorn_assign(scores, _bin(1.0), iterations=rounds)[0, :-1].sum(dim=1) - 1).abs().max())
        for rounds in (1, 3, 10, 100)
    ]
    assert misses == sorted(misses, reverse=True)
    assert misses[-1] < 1e-6 < misses[1]


@pytest.mark.parametrize("transport_", ["sinkhorn", "softmax", "dual-softmax"])
@pytest.mark.parametrize("dustbin", [True, False])
@pytest.mark.parametrize("scene_dim", [0, 5])
@torch.no_grad()
def test_a_variant_sums_features_by_its_own_plan(transport_: str, dustbin: bool, scene_dim: int) -> None:
    model = _salad(transport=transport_, dustbin=dustbin, scene_dim=scene_dim)
    tokens = _tokens()
    scores, score = model.score(tokens.patches).transpose(1, 2), torch.tensor(1.0) if dustbin else None
    plan = {"sinkhorn": sinkhorn.sinkhorn_assign, "softmax": softmax, "dual-softmax": dual_softmax}[transport_](
        scores, score
    )
    torch.testing.assert_close(model.plan(tokens), plan)
    assert plan.shape[1] == 3 + dustbin
    for row, features in enumerate(model.feature(tokens.patches)):
        volume = features.T @ plan[row, :3].T
        parts = [(volume / volume.norm(dim=0)).flatten()]
        if model.scene is not None:
            scene = model.scene(tokens.cls[row])
            parts.insert(0, scene / scene.norm())
        expected = torch.cat(parts)
        torch.testing.assert_close(model(tokens)[row], expected / expected.norm())
    assert model.dim == scene_dim + 12


def test_only_the_weights_a_variant_uses_are_there() -> None:
    def keys(**change: object) -> set[str]:
        return {key.split(".")[0] for key in _salad(**change).state_dict()}

    assert keys() == {"score", "feature", "scene", "dustbin"}
    assert keys(dustbin=False) == {"score", "feature", "scene"}
    assert keys(scene_dim=0) == {"score", "feature", "dustbin"}


@torch.no_grad()
def test_rounds_belong_to_the_model() -> None:
    one, three, many = (_salad(iterations=rounds).plan(_tokens()) for rounds in (1, 3, 50))
    torch.testing.assert_close(three, _salad().plan(_tokens()), rtol=0, atol=0)
    assert float((one - three).abs().max()) > 1e-4
    assert float((many[:, :3].sum(dim=2) - 1).abs().max()) < 1e-3


@torch.no_grad()
def test_only_a_transport_with_a_dustbin_needs_more_tokens_than_clusters() -> None:
    few = _tokens(tokens=3)
    with pytest.raises(TooFewTokensError, match="3 clusters need more than 3"):
        _salad()(few)
    for change in ({"dustbin": False}, {"transport": "softmax"}, {"transport": "dual-softmax"}):
        assert _salad(**change)(few).shape == (2, 17)


@pytest.mark.parametrize("transport_", ["softmax", "dual-softmax"])
def test_plans_stay_float32_under_autocast(transport_: str) -> None:
    model, tokens = _salad(transport=transport_), _tokens()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        plan, descriptor = model.plan(tokens), model(tokens)
    assert plan.dtype == torch.float32
    assert float(F.cosine_similarity(descriptor.float(), model(tokens)).detach().min()) > 0.999


def test_a_softmax_learns_the_dustbins_score_and_sinkhorn_cannot() -> None:
    slopes = {}
    for way in ("sinkhorn", "softmax", "dual-softmax"):
        model = _salad(transport=way).double()
        tokens = _tokens()
        model.plan(tokens._replace(patches=tokens.patches.double()))[:, 0].square().sum().backward()
        assert model.dustbin is not None
        assert model.dustbin.grad is not None
        slopes[way] = abs(float(model.dustbin.grad))
    assert slopes["sinkhorn"] < 1e-12 < 1e-4 < min(slopes["softmax"], slopes["dual-softmax"])
