"""Scores and masses -> plan: how much of every token each cluster takes, the dustbin included.

Pure functions. Every token has mass 1, every cluster wants mass 1, and the dustbin wants what is left. The
entropic transport problem is solved in log space by Sinkhorn's iteration (Cuturi, 2013); SALAD stops it after
three rounds, and the three belongs to the model: its published weights were trained with an unfinished plan.
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
    for _ in range(iterations):
        rows = log_rows[:, None] - torch.logsumexp(scores + columns, dim=2, keepdim=True)
        columns = log_columns - torch.logsumexp(scores + rows, dim=1, keepdim=True)
    return scores + rows + columns


def share(
    scores: Float[Tensor, "batch m n"], dustbin: Float[Tensor, ""], *, stride: int = 1
) -> Float[Tensor, "batch m_and_dustbin n"]:
    """Share every token among m clusters and, as the last row, the dustbin.

    Computed in float32 at least, whatever autocast says: bfloat16 cannot hold a sum of logs.

    Args:
        scores: one row a cluster, one column a token.
        dustbin: the score every token has for the dustbin.
        stride: pixels from one token to the next, for the error's advice.

    Returns:
        The plan: every column sums to 1.

    Raises:
        TooFewTokensError: there are not more tokens than clusters.
    """
    batch, clusters, tokens = scores.shape
    if tokens <= clusters:
        side = stride * (math.isqrt(clusters) + 1)
        raise TooFewTokensError(
            f"the photo gives {tokens} tokens, but {clusters} clusters need more than {clusters}; "
            f"use images of at least {side} x {side} pixels"
        )
    with torch.autocast(scores.device.type, enabled=False):
        exact = scores if scores.dtype == torch.float64 else scores.float()
        last_row = dustbin.to(exact.dtype).expand(batch, 1, tokens)
        log_rows = exact.new_zeros(clusters + 1)
        log_rows[-1] = math.log(tokens - clusters)
        log_plan = sinkhorn(torch.cat([exact, last_row], dim=1), log_rows, exact.new_zeros(tokens))
        return log_plan.exp()
