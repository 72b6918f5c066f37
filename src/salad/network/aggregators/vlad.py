"""VLAD: what each photo's tokens add to the words of a vocabulary, without any training.

Sources: Jégou, Douze, Schmid and Pérez, "Aggregating local descriptors into a compact image representation" (2010);
Arandjelović and Zisserman, "All about VLAD" (2013) for the normalisation of each word; Keetha et al., "AnyLoc:
Towards Universal Visual Place Recognition" (2023), who put it on DINOv2's tokens with a vocabulary of the domain.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError
from salad.network.baseline_config import VladConfig
from salad.network.tokens import Tokens


class Vlad(nn.Module):
    """Residuals to the nearest word, summed for each word; number w * d + i is residual i of word w.

    The vocabulary comes from photos (`salad.training.start.fit`), is kept with the weights, and nothing trains it.
    """

    vocabulary: Tensor
    fitted: Tensor

    def __init__(self, config: VladConfig) -> None:
        super().__init__()
        self.config, self.dim = config, config.dim
        # Buffers and no parameters: kept with the weights and moved with them, but nothing trains them.
        self.register_buffer("vocabulary", torch.zeros(config.clusters, config.width))
        self.register_buffer("fitted", torch.tensor(False))

    def forward(self, tokens: Tokens) -> Float[Tensor, "batch dim"]:
        """Describe each photo of the batch by one vector of length 1.

        Raises:
            ModelError: If there is no vocabulary yet.
        """
        # An exporter cannot follow what depends on a weight; whoever exports asks for the vocabulary beforehand.
        if not torch.compiler.is_exporting() and not self.fitted:
            raise ModelError(
                "this VLAD has no vocabulary yet: make one from the photos of an index with 'salad weights vocabulary'"
            )
        units = F.normalize(tokens.patches, dim=2)
        # The nearest word: of vectors of length 1, that with the largest u·w - |w|²/2.
        words = (units @ self.vocabulary.T - self.vocabulary.square().sum(dim=1) / 2).argmax(dim=2)
        belongs = F.one_hot(words, self.config.clusters).to(units.dtype)
        return joined(residuals(units, belongs, self.vocabulary))

    def start_from(self, centroids: Float[Tensor, "k d"], units: Float[Tensor, "t d"]) -> None:  # noqa: ARG002  # called as NetVLAD's
        """Take centroids of tokens of length 1 as the vocabulary."""
        self.vocabulary.copy_(centroids)
        self.fitted.fill_(True)


def residuals(
    units: Float[Tensor, "batch n d"], weights: Float[Tensor, "batch n k"], centroids: Float[Tensor, "k d"]
) -> Float[Tensor, "batch k d"]:
    """For each centroid the sum of weight * (token - centroid); no [batch, n, k, d] tensor is built."""
    summed = torch.einsum("bnk,bnd->bkd", weights, units)
    return summed - weights.sum(dim=1).unsqueeze(2) * centroids


def joined(sums: Float[Tensor, "batch k d"]) -> Float[Tensor, "batch dim"]:
    """One vector of length 1 for each photo: every centroid's sum counts the same, however many tokens it had."""
    return F.normalize(F.normalize(sums, dim=2).flatten(1), dim=1)
