"""Scores and masses -> plan: how much of every token each cluster takes, the dustbin included.

Pure functions. Every token has mass 1, every cluster wants mass 1, and the dustbin wants what is left; or the dustbin
wants a share of all, and the clusters alike what it leaves. The entropic transport problem is solved in log space by
Sinkhorn's iteration (Cuturi, 2013); SALAD stops it after three rounds, and the three belongs to the model: its
published weights were trained with an unfinished plan. `sinkhorn_assign` is that; `softmax` and `dual_softmax` are
what the paper compares it with.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from salad.errors import TooFewTokensError

ITERATIONS = 3


def sinkhorn(
    scores: Float[Tensor, "batch rows columns"],
    log_rows: Float[Tensor, " rows"],
    log_columns: Float[Tensor, " columns"],
    *,
    iterations: int = ITERATIONS,
) -> Float[Tensor, "batch rows columns"]:
    """The log of a plan whose columns carry their mass exactly and whose rows nearly so.

    Args:
        scores: what it is worth to move a column's mass to a row.
        log_rows: log of the mass each row wants.
        log_columns: log of the mass each column has.
        iterations: rounds, each rows first and columns second, from zero potentials.
    """
    columns = scores.new_zeros(scores.shape[0], 1, scores.shape[2])
    rows = scores.new_zeros(scores.shape[0], scores.shape[1], 1)
    # Rows first and columns last: so a token's mass is exact after any number of rounds, and only a cluster's is near.
    for _ in range(iterations):
        rows = log_rows[:, None] - torch.logsumexp(scores + columns, dim=2, keepdim=True)
        columns = log_columns - torch.logsumexp(scores + rows, dim=1, keepdim=True)
    return scores + rows + columns


def sinkhorn_assign(
    scores: Float[Tensor, "batch m n"],
    dustbin: Float[Tensor, ""] | None,
    *,
    wants: float | None = None,
    stride: int = 1,
    iterations: int = ITERATIONS,
) -> Float[Tensor, "batch rows n"]:
    """Share every token among m clusters and, as the last row, the dustbin where there is one.

    Computed in float32 at least, whatever autocast says: bfloat16 cannot hold a sum of logs.

    Args:
        scores: one row a cluster, one column a token.
        dustbin: the score every token has for the dustbin; None for none, and every cluster wants n / m.
        wants: the dustbin's share of all tokens; None for what is left once every cluster has the mass of one.
        stride: pixels from one token to the next, for the error's advice.
        iterations: Sinkhorn's rounds.

    Returns:
        The plan: every column sums to 1.

    Raises:
        TooFewTokensError: If there is a dustbin that wants what is left, and there are not more tokens than clusters.
    """
    _, clusters, tokens = scores.shape
    if dustbin is not None and wants is None and tokens <= clusters:
        side = stride * (math.isqrt(clusters) + 1)  # of the smallest square with more tokens than clusters
        raise TooFewTokensError(
            f"the photo gives {tokens} tokens, but {clusters} clusters need more than {clusters}; "
            f"use images of at least {side} x {side} pixels"
        )
    with torch.autocast(scores.device.type, enabled=False):
        rows = _rows(scores, dustbin)
        if dustbin is None:
            log_rows = rows.new_full((clusters,), math.log(tokens / clusters))
        else:
            # The paper's dustbin wants what is left once each cluster has the mass of one token. Of a larger photo that
            # is more and more; a fixed fraction of the tokens is for models trained with one.
            lost = tokens - clusters if wants is None else tokens * wants
            log_rows = rows.new_full((clusters + 1,), math.log((tokens - lost) / clusters))
            log_rows[-1] = math.log(lost)
        return sinkhorn(rows, log_rows, rows.new_zeros(tokens), iterations=iterations).exp()


def softmax(scores: Float[Tensor, "batch m n"], dustbin: Float[Tensor, ""] | None) -> Float[Tensor, "batch rows n"]:
    """Share every token by its own scores alone: a softmax over the clusters and, as the last row, the dustbin.

    Returns:
        The plan: every column sums to 1, and a row to anything.
    """
    with torch.autocast(scores.device.type, enabled=False):
        return _rows(scores, dustbin).softmax(dim=1)


def dual_softmax(
    scores: Float[Tensor, "batch m n"], dustbin: Float[Tensor, ""] | None
) -> Float[Tensor, "batch rows n"]:
    """A softmax over the clusters times one over the tokens: much where both prefer each other.

    Source: the matching layer of Sun et al., "LoFTR" (2021), which SALAD's ablation puts in Sinkhorn's place.

    Returns:
        What is no plan: neither a column nor a row carries a mass, each sums to less than 1.
    """
    with torch.autocast(scores.device.type, enabled=False):
        rows = _rows(scores, dustbin)
        return rows.softmax(dim=1) * rows.softmax(dim=2)


def _rows(scores: Tensor, dustbin: Tensor | None) -> Tensor:
    """The scores in float32 at least, the dustbin's below them."""
    # bfloat16 would round each exponential by up to 0.4 %; double is left alone, for tests of gradients.
    exact = scores if scores.dtype == torch.float64 else scores.float()
    if dustbin is None:
        return exact
    return torch.cat([exact, dustbin.to(exact.dtype).expand(exact.shape[0], 1, exact.shape[2])], dim=1)
