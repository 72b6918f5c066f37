"""The multi-similarity loss, on the pairs that its miner finds worth learning from."""

from __future__ import annotations

from collections.abc import Callable

from jaxtyping import Float, Int64
from torch import Tensor

from salad.errors import needs_extra

Objective = Callable[[Float[Tensor, "batch dim"], Int64[Tensor, " batch"]], Float[Tensor, ""]]
"""Descriptors and the place each shows -> loss."""


def multi_similarity(*, alpha: float = 1.0, beta: float = 50.0, base: float = 0.0, margin: float = 0.1) -> Objective:
    """The multi-similarity loss on the pairs worth learning from, as the paper sets it.

    Source: Wang et al., "Multi-Similarity Loss with General Pair Weighting for Deep Metric Learning", CVPR 2019.

    Args:
        alpha: weight of pairs of one place.
        beta: weight of pairs of two places.
        base: similarity at which a pair is content.
        margin: the miner keeps a pair that is within this of the hardest one of the other kind.

    Raises:
        MissingExtraError: If pytorch-metric-learning is not installed.
    """
    with needs_extra("training", "train"):
        from pytorch_metric_learning import distances, losses, miners
    loss = losses.MultiSimilarityLoss(alpha, beta, base, distance=distances.DotProductSimilarity())
    miner = miners.MultiSimilarityMiner(margin, distance=distances.CosineSimilarity())

    def objective(descriptors: Tensor, labels: Tensor) -> Tensor:
        value: Tensor = loss(descriptors, labels, miner(descriptors, labels))
        return value

    return objective
