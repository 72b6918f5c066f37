"""SALAD as one torch module: a backbone cuts photos into tokens, an aggregator makes one descriptor of them.

    images ──> backbone ──> tokens ──> aggregator ──> descriptor
                               └─────> plan

Training, conversion and checks work on this module. Whoever only describes photos goes through `salad.models`, where
an engine runs it and everything is an array.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from salad.errors import ModelError, WeightsError
from salad.network.aggregators.base import build_aggregator
from salad.network.backbones.base import build_backbone
from salad.network.config import ModelConfig, Output, check_sizes
from salad.network.tokens import Tokens

Bytes = UInt8[np.ndarray, "batch height width 3"] | UInt8[Tensor, "batch height width 3"]


class Network(nn.Module):
    """A backbone and an aggregator, with the normalisation they were trained with.

    Its weights are named `backbone.*` and `aggregator.*`; these names stand in files and never change.

    Raises:
        ModelError: If backbone and aggregator do not fit together.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = build_backbone(config.backbone)
        self.aggregator = build_aggregator(config.aggregator)
        if config.aggregator.width != self.backbone.width:
            raise ModelError(
                f"the aggregator takes tokens of {config.aggregator.width} numbers, but the backbone makes them of "
                f"{self.backbone.width}"
            )
        # Not persistent: they belong to the configuration, and published weights hold no such tensors.
        for name in ("mean", "std"):
            values = torch.tensor(getattr(config.preprocessing, name)).view(3, 1, 1)
            self.register_buffer(name, values, persistent=False)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.mean.device

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch dim"]:
        """Describe normalised images; a side that is no multiple of the stride is rounded to the nearest one.

        Raises:
            TooFewTokensError: If the images are too small for the model's clusters.
        """
        descriptors: Tensor = self.aggregator(self.tokens(images))
        return descriptors

    def tokens(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised images into tokens."""
        stride = self.backbone.stride
        # At least one token a side: a tiny photo is stretched, and too few tokens are the aggregator's to refuse.
        size = [max(1, round(side / stride)) * stride for side in images.shape[-2:]]
        if size != list(images.shape[-2:]):
            images = F.interpolate(images, size=size, mode="bilinear", antialias=True)
        tokens: Tokens = self.backbone(images)
        return tokens

    def normalise(self, photos: Bytes) -> Float[Tensor, "batch 3 height width"]:
        """Photos as they are decoded -> images as `forward` takes them, where the weights are."""
        images = torch.as_tensor(photos, device=self.device).permute(0, 3, 1, 2)
        return (images.float() / 255 - self.mean) / self.std

    def outputs(self, photos: Bytes, names: Sequence[Output]) -> dict[Output, Float[Tensor, "batch ..."]]:
        """What an engine gives (`salad.models.engines`), each asked for by its name; normalisation is part of it."""
        tokens = self.tokens(self.normalise(photos))
        made: dict[Output, Tensor] = {}
        for name in names:
            if name == "descriptor":
                made[name] = self.aggregator(tokens)
            elif name == "patches":
                made[name] = tokens.patches.reshape(photos.shape[0], *tokens.grid, self.backbone.width)
            elif name == "cls":
                made[name] = tokens.cls
            else:  # only configurations that say `has_plan` come here, whose modules have one
                plan: Tensor = cast(Any, self.aggregator).plan(tokens)
                made[name] = plan.reshape(*plan.shape[:2], *tokens.grid)
        return made

    def weights(self) -> dict[str, np.ndarray]:
        """The weights and buffers under their serialised names; float32, integers as they are."""
        # On the processor these are views and no copies: a fingerprint of a large model need not double its memory.
        return {
            key: (value.float() if value.is_floating_point() else value).detach().cpu().numpy()
            for key, value in self.state_dict().items()
        }

    @property
    def fingerprint(self) -> str:
        """As of the model it is: computed at every call, so it follows what is trained."""
        return self.config.fingerprint(self.weights())


class evaluating:  # noqa: N801  # reads as a verb
    """Evaluation mode inside; behind it, every part of the module is in the mode it was in before.

    Several threads may be inside at once: the first to come changes the mode, and the last to leave restores it.
    """

    _lock: ClassVar = threading.Lock()
    _inside: ClassVar[dict[nn.Module, tuple[int, list[nn.Module]]]] = {}  # how many, and which parts were training

    def __init__(self, module: nn.Module) -> None:
        self.module = module

    def __enter__(self) -> None:
        with self._lock:
            threads, training = self._inside.get(self.module, (0, []))
            if not threads:
                # Part by part: a frozen backbone may evaluate within a module that trains.
                training = [part for part in self.module.modules() if part.training]
                self.module.eval()
            self._inside[self.module] = threads + 1, training

    def __exit__(self, *_: object) -> None:
        with self._lock:
            threads, training = self._inside.pop(self.module)
            if threads > 1:
                self._inside[self.module] = threads - 1, training
                return
            for part in training:
                part.training = True


def build(config: ModelConfig, *, seed: int = 0) -> Network:
    """A network with untrained weights, the same for the same seed.

    Raises:
        ModelError: If the configuration's parts do not fit together.
    """
    # Whoever draws numbers outside goes on as if nothing had been built; and weights made in a caller's inference mode
    # could never be trained.
    with torch.random.fork_rng(devices=[]), torch.inference_mode(False):
        torch.manual_seed(seed)
        return Network(config).eval()


def _without_memory(config: ModelConfig) -> Mapping[str, Tensor]:
    """The shapes that a configuration asks for, whatever it asks for: nothing is allocated for them."""
    try:
        with torch.device("meta"), torch.inference_mode(False):
            return Network(config).state_dict()
    except NotImplementedError:  # a part of another package looks at its numbers; then it is built to be known
        return build(config).state_dict()


def _check_fit(wanted: Mapping[str, Tensor], weights: Mapping[str, Any], *, source: Path) -> None:
    """Make sure that weights have the names and shapes of a network's, no more and no less.

    Raises:
        WeightsError: If not; the message lists them.
    """
    wrong = {
        "missing": wanted.keys() - weights.keys(),
        "unknown": weights.keys() - wanted.keys(),
        "of another shape": {
            key for key in wanted.keys() & weights.keys() if tuple(wanted[key].shape) != weights[key].shape
        },
    }
    if any(wrong.values()):
        said = "; ".join(f"{what}: {', '.join(sorted(keys))}" for what, keys in wrong.items() if keys)
        raise WeightsError(f"{source} does not fit the model it describes; {said}")


def load_weights(config: ModelConfig, weights: Mapping[str, Any], *, source: Path) -> Network:
    """A network with these weights, whose names and shapes must be those of the configuration, no more and no less.

    Args:
        config: What to build.
        weights: Arrays or tensors under their serialised names, of any precision.
        source: The file they are from, for the error's sentence.

    Raises:
        WeightsError: If no such model can be built, or a tensor is missing, unknown or of another shape.
    """
    try:
        check_sizes(config)
        _check_fit(_without_memory(config), weights, source=source)
        network = build(config)
    except (ModelError, RuntimeError, TypeError, ValueError) as error:  # a damaged file asks for anything
        raise WeightsError(f"{source} does not describe a model that can be built: {error}") from error
    wanted = network.state_dict()
    _check_fit(wanted, weights, source=source)
    # Half precision on disk is a matter of size alone: what runs is float32.
    network.load_state_dict({key: torch.as_tensor(weights[key]).to(value.dtype) for key, value in wanted.items()})
    return network
