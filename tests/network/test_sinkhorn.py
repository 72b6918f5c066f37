"""Transport: a plan against the plain iteration, the problem's own conditions, and every assignment there is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from beartype import beartype
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import jaxtyped
from torch import Tensor

from salad.errors import TooFewTokensError
from salad.network import sinkhorn as transport

sinkhorn_assign = jaxtyped(typechecker=beartype)(transport.sinkhorn_assign)
sinkhorn = jaxtyped(typechecker=beartype)(transport.sinkhorn)

sizes = st.tuples(st.integers(1, 3), st.integers(1, 6), st.integers(1, 20))  # batch, clusters, tokens more
seeds = st.integers(0, 2**32 - 1)
quick = settings(deadline=None, max_examples=30)


def _scores(size: tuple[int, int, int], seed: int, scale: float = 2.0) -> Tensor:
    batch, clusters, more = size
    chance = np.random.default_rng(seed)
    return torch.from_numpy(chance.normal(0, scale, (batch, clusters, clusters + more)))


def _plain(scores: np.ndarray, dustbin: float, *, rounds: int) -> np.ndarray:
    """The same in plain space for one photo: scale the rows, then the columns, from factors of 1."""
    clusters, tokens = scores.shape
    kernel = np.exp(np.vstack([scores, np.full((1, tokens), dustbin)]))
    wanted = np.append(np.ones(clusters), tokens - clusters)
    columns = np.ones(tokens)
    for _ in range(rounds):
        rows = wanted / (kernel @ columns)
        columns = 1 / (kernel.T @ rows)
    return rows[:, None] * kernel * columns


@quick
@given(sizes, seeds, st.floats(-3, 3))
def test_share_is_three_plain_rounds(size: tuple[int, int, int], seed: int, dustbin: float) -> None:
    scores = _scores(size, seed)
    plan = sinkhorn_assign(scores, torch.tensor(dustbin, dtype=torch.float64))
    expected = np.stack([_plain(one.numpy(), dustbin, rounds=3) for one in scores])
    np.testing.assert_allclose(plan.numpy(), expected, rtol=1e-9, atol=1e-12)


@quick
@given(sizes, seeds)
def test_a_dustbin_that_wants_the_papers_share_is_the_papers(size: tuple[int, int, int], seed: int) -> None:
    scores, dustbin = _scores(size, seed), torch.tensor(1.0, dtype=torch.float64)
    _, clusters, tokens = scores.shape
    torch.testing.assert_close(
        sinkhorn_assign(scores, dustbin, wants=(tokens - clusters) / tokens),
        sinkhorn_assign(scores, dustbin),
        rtol=1e-9,
        atol=1e-12,
    )


@quick
@given(sizes, seeds, st.floats(0.01, 0.99), st.integers(1, 3))
def test_a_dustbin_takes_the_share_it_wants(size: tuple[int, int, int], seed: int, wants: float, times: int) -> None:
    """However many tokens there are, fewer than clusters too, once the plan is finished."""
    scores = _scores(size, seed, scale=1.0)[:, :, :: 2 * times]
    plan = sinkhorn_assign(scores, torch.tensor(1.0, dtype=torch.float64), wants=wants, iterations=1000)
    due = plan.new_full(plan.shape[:2], (1 - wants) / scores.shape[1])
    due[:, -1] = wants
    torch.testing.assert_close(plan.mean(dim=2), due, rtol=0, atol=1e-8)


@quick
@given(sizes, seeds)
def test_every_token_has_mass_one_and_no_share_is_negative(size: tuple[int, int, int], seed: int) -> None:
    plan = sinkhorn_assign(_scores(size, seed, scale=10).float(), torch.tensor(1.0))
    assert plan.dtype == torch.float32
    assert bool((plan >= 0).all())
    torch.testing.assert_close(plan.sum(dim=1), torch.ones(plan.shape[0], plan.shape[2]), rtol=0, atol=1e-5)


def test_token_mass_is_exact_in_float64() -> None:
    plan = sinkhorn_assign(_scores((2, 5, 9), 3), torch.tensor(1.0, dtype=torch.float64))
    torch.testing.assert_close(plan.sum(dim=1), torch.ones(2, 14, dtype=torch.float64), rtol=0, atol=1e-14)


@quick
@given(sizes, seeds)
def test_tokens_and_clusters_may_be_reordered(size: tuple[int, int, int], seed: int) -> None:
    scores, dustbin = _scores(size, seed), torch.tensor(0.5, dtype=torch.float64)
    chance = np.random.default_rng(seed)
    tokens = torch.from_numpy(chance.permutation(scores.shape[2]))
    clusters = torch.from_numpy(chance.permutation(scores.shape[1]))
    plan = sinkhorn_assign(scores, dustbin)
    moved = sinkhorn_assign(scores[:, clusters][:, :, tokens], dustbin)
    rows = torch.cat([clusters, torch.tensor([scores.shape[1]])])
    torch.testing.assert_close(moved, plan[:, rows][:, :, tokens], rtol=1e-10, atol=1e-12)


@quick
@given(sizes, seeds, st.floats(-50, 50))
def test_a_constant_on_all_scores_changes_nothing(size: tuple[int, int, int], seed: int, more: float) -> None:
    scores, dustbin = _scores(size, seed), torch.tensor(1.0, dtype=torch.float64)
    torch.testing.assert_close(
        sinkhorn_assign(scores + more, dustbin + more),
        sinkhorn_assign(scores, dustbin),
        rtol=1e-9,
        atol=1e-12,
    )


@quick
@given(sizes, seeds)
def test_many_rounds_meet_the_conditions_of_the_one_best_plan(size: tuple[int, int, int], seed: int) -> None:
    """The entropic problem has one solution: the masses are met, and log plan - scores is a sum of potentials."""
    scores = _scores(size, seed, scale=1.0)
    _, clusters, tokens = scores.shape
    rows = torch.ones(clusters, dtype=torch.float64)
    rows[-1] += tokens - clusters  # masses of both sides must add up
    log_plan = sinkhorn(scores, rows.log(), torch.zeros(tokens, dtype=torch.float64), iterations=1000)
    plan = log_plan.exp()
    torch.testing.assert_close(plan.sum(dim=2), rows.expand(len(scores), -1), rtol=0, atol=1e-8)
    torch.testing.assert_close(plan.sum(dim=1), torch.ones_like(plan[:, 0]), rtol=0, atol=1e-8)
    rest = log_plan - scores
    mixed = rest - rest[:, :1] - rest[:, :, :1] + rest[:, :1, :1]
    torch.testing.assert_close(mixed, torch.zeros_like(mixed), rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_sharp_scores_find_the_best_of_all_assignments(seed: int) -> None:
    """With little entropy the plan is the linear problem's: compared with trying every assignment."""
    clusters, tokens = 2, 5
    scores = torch.from_numpy(np.random.default_rng(seed).normal(size=(clusters, tokens)))
    augmented = torch.cat([scores, torch.zeros(1, tokens, dtype=torch.float64)])
    log_rows = torch.tensor([1.0, 1.0, tokens - clusters], dtype=torch.float64).log()
    flat = torch.zeros(tokens, dtype=torch.float64)
    plan = sinkhorn(200 * augmented[None], log_rows, flat, iterations=3000)[0].exp()
    best = max(itertools.permutations(range(tokens), clusters), key=lambda t: float(scores[range(2), t].sum()))
    expected = torch.zeros(3, tokens, dtype=torch.float64)
    for cluster, token in enumerate(best):
        expected[cluster, token] = 1
    expected[2] = 1 - expected[:2].sum(dim=0)
    torch.testing.assert_close(plan, expected, rtol=0, atol=0.02)


def test_three_rounds_are_not_the_end() -> None:
    """The model's plan is an unfinished one: a cluster's mass is only near 1."""
    plan = sinkhorn_assign(_scores((1, 6, 12), 0, scale=3.0), torch.tensor(1.0, dtype=torch.float64))
    assert float((plan[0, :-1].sum(dim=1) - 1).abs().max()) > 1e-3


@quick
@given(sizes, seeds, st.floats(-20, 20))
def test_the_first_round_absorbs_the_height_of_a_row(size: tuple[int, int, int], seed: int, more: float) -> None:
    """Only what differs from token to token counts: so the dustbin's one number decides nothing by itself."""
    scores = _scores(size, seed)
    plan = sinkhorn_assign(scores, torch.tensor(1.0, dtype=torch.float64))
    other = sinkhorn_assign(scores, torch.tensor(1.0 + more, dtype=torch.float64))
    torch.testing.assert_close(other, plan, rtol=1e-9, atol=1e-12)


def test_the_dustbin_takes_the_tokens_that_no_cluster_wants() -> None:
    scores = torch.full((1, 2, 6), -8.0, dtype=torch.float64)
    scores[0, 0, 1] = scores[0, 1, 4] = 8.0
    taken = sinkhorn_assign(scores, torch.tensor(1.0, dtype=torch.float64))[0, -1]
    assert [bool(share > 0.9) for share in taken] == [True, False, True, True, False, True]


def test_gradients_are_right() -> None:
    scores = _scores((2, 3, 4), 5).requires_grad_()
    dustbin = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(transport.sinkhorn_assign, (scores, dustbin))


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float32])
def test_it_is_computed_in_float32_whatever_autocast_says(dtype: torch.dtype) -> None:
    scores, dustbin = _scores((2, 6, 30), 2, scale=5.0).to(dtype), torch.tensor(1.0)
    expected = transport.sinkhorn_assign(scores.float(), dustbin)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        plan = sinkhorn_assign(scores, dustbin)
    assert plan.dtype == torch.float32
    torch.testing.assert_close(plan, expected, rtol=0, atol=0)


@pytest.mark.parametrize(("clusters", "stride", "side"), [(64, 14, 126), (32, 14, 84), (16, 14, 70), (32, 16, 96)])
def test_too_few_tokens_name_the_smallest_side_that_works(clusters: int, stride: int, side: int) -> None:
    dustbin = torch.tensor(1.0)
    below, enough = ((side // stride - 1) ** 2, (side // stride) ** 2)
    with pytest.raises(TooFewTokensError, match=rf"at least {side} x {side} pixels"):
        sinkhorn_assign(torch.zeros(1, clusters, below), dustbin, stride=stride)
    assert sinkhorn_assign(torch.zeros(1, clusters, enough), dustbin, stride=stride).shape == (
        1,
        clusters + 1,
        enough,
    )


def test_as_many_tokens_as_clusters_is_too_few() -> None:
    with pytest.raises(TooFewTokensError, match="gives 9 tokens, but 9 clusters"):
        sinkhorn_assign(torch.zeros(1, 9, 9), torch.tensor(1.0))
    assert bool(sinkhorn_assign(torch.zeros(1, 9, 10), torch.tensor(1.0)).isfinite().all())


def test_extreme_scores_stay_finite() -> None:
    scores = torch.tensor([[[1e4, -1e4, 0.0, 1e4], [-1e4, -1e4, 1e4, 1e4]]])
    plan = sinkhorn_assign(scores, torch.tensor(1.0))
    assert bool(plan.isfinite().all())
