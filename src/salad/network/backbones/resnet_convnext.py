"""ResNet-50 and ConvNeXt, built by `transformers` from a configuration: pixels -> the same Tokens.

Nothing is fetched: they start at random, and `own_names` lets a local file of weights fill them. Neither has a class
token, so the mean of its patches stands for the scene. `transformers` is imported when one is built and never before.
Sources: He, Zhang, Ren and Sun, "Deep Residual Learning for Image Recognition" (2015); Liu et al., "A ConvNet for
the 2020s" (2022).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any, Self

from jaxtyping import Float
from torch import Tensor, nn

from salad.errors import needs_extra
from salad.network.backbones.base import Backbone
from salad.network.config import ConvNextConfig, ResNetConfig
from salad.network.tokens import Tokens

RESNET50 = ((3, 256), (4, 512), (6, 1024), (3, 2048))  # blocks and channels of each stage
CONVNEXT = {
    "tiny": ((3, 96), (3, 192), (9, 384), (3, 768)),
    "base": ((3, 128), (3, 256), (27, 512), (3, 1024)),
}
FIRST_STRIDE = 4  # pixels from one cell to the next after the stem; every later stage doubles it

# torchvision's names of ResNet's parts, and ours
TORCHVISION = (
    (r"^conv1\.", "embedder.embedder.convolution."),
    (r"^bn1\.", "embedder.embedder.normalization."),
    (r"^layer(\d)\.(\d+)\.downsample\.0\.", r"encoder.stages.\1.layers.\2.shortcut.convolution."),
    (r"^layer(\d)\.(\d+)\.downsample\.1\.", r"encoder.stages.\1.layers.\2.shortcut.normalization."),
    (r"^layer(\d)\.(\d+)\.conv(\d)\.", r"encoder.stages.\1.layers.\2.layer.\3.convolution."),
    (r"^layer(\d)\.(\d+)\.bn(\d)\.", r"encoder.stages.\1.layers.\2.layer.\3.normalization."),
)


class Staged(Backbone):
    """A trunk of stages, named as `transformers` names them."""

    encoder: nn.ModuleDict

    @property
    def stages(self) -> Any:
        """Its stages, from the finest grid to the coarsest."""
        return self.encoder["stages"]


class ResNet(Staged):
    """ResNet-50's trunk up to a stage.

    Its normalisation keeps the statistics it was given, in training too: a batch of few places has poor ones.

    Raises:
        MissingExtraError: If `transformers` is not installed.
    """

    def __init__(self, config: ResNetConfig) -> None:
        super().__init__()
        transformers = _transformers("a ResNet")
        depths, widths = zip(*RESNET50[: config.stages], strict=True)
        whole = transformers.ResNetModel(transformers.ResNetConfig(depths=list(depths), hidden_sizes=list(widths)))
        self.config, self.width = config, widths[-1]
        self.stride = FIRST_STRIDE * 2 ** (config.stages - 1)
        # What pools and classifies is left out, so that a state dict holds what the tokens come from and no more.
        self.embedder = whole.embedder
        self.encoder = nn.ModuleDict({"stages": whole.encoder.stages})
        self.train(self.training)  # from the start: nobody need call `eval` for the normalisation's sake

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised photos into tokens; both sides are multiples of the stride."""
        x = self.embedder(images)
        for stage in self.stages:
            x = stage(x)
        return Tokens.of_maps(x, self.stride)

    def train(self, mode: bool = True) -> Self:
        """Set the mode of everything but the normalisation, which stays as in use."""
        super().train(mode)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self

    def blocks_in_order(self) -> list[list[nn.Module]]:
        """The residual blocks of all stages."""
        return [[block] for stage in self.stages for block in stage.layers]


class ConvNext(Staged):
    """ConvNeXt's trunk up to a stage, each patch normalised at the end as the whole model does with their mean.

    Raises:
        MissingExtraError: If `transformers` is not installed.
    """

    def __init__(self, config: ConvNextConfig) -> None:
        super().__init__()
        transformers = _transformers("a ConvNeXt")
        depths, widths = zip(*CONVNEXT[config.size][: config.stages], strict=True)
        whole = transformers.ConvNextModel(
            transformers.ConvNextConfig(num_stages=config.stages, depths=list(depths), hidden_sizes=list(widths))
        )
        self.config, self.width = config, widths[-1]
        self.stride = FIRST_STRIDE * 2 ** (config.stages - 1)
        self.embeddings = whole.embeddings
        self.encoder = nn.ModuleDict({"stages": whole.encoder.stages})
        self.norm = nn.LayerNorm(self.width, eps=1e-6)  # as wide as the cut, where the whole model's is of its end

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Tokens:
        """Cut normalised photos into tokens; both sides are multiples of the stride."""
        x = self.embeddings(images)
        for stage in self.stages:
            x = stage(x)
        return Tokens.of_maps(self.norm(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2), self.stride)

    def blocks_in_order(self) -> list[list[nn.Module]]:
        """The blocks of all stages; what narrows the grid before a stage's first block belongs to that block."""
        parts: list[list[nn.Module]] = []
        for stage in self.stages:
            first, *rest = stage.layers
            parts += [[stage.downsampling_layer, first], *([block] for block in rest)]
        return parts

    def train_last(self, blocks: int) -> None:
        """Leave only the last `blocks` blocks and the norm to be trained, and the stem with all; 0: nothing."""
        super().train_last(blocks)
        self.norm.requires_grad_(blocks > 0)


def own_names(backbone: nn.Module, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A file's tensors under the names of a ResNet or ConvNeXt, those it has no place for left out.

    A file of any other backbone has its names already, and is given back as it is. Known are the names of
    `transformers`, with or without `resnet.` or `convnext.` before them, and torchvision's of ResNet. A final norm
    of another width is the whole model's, and a trunk cut before its end learns its own.

    Args:
        backbone: What is to be filled.
        tensors: As `checkpoints.read_tensors` gives them.
    """
    if not isinstance(backbone, ResNet | ConvNext):
        return dict(tensors)
    # A file of the whole model holds stages beyond the cut and a classifier: what is not wanted is left where it is.
    wanted = backbone.state_dict()
    found = {_own_name(key): value for key, value in tensors.items()}
    norm = found.get("norm.weight")
    if norm is not None and norm.shape != (backbone.width,):
        found = {key: value for key, value in found.items() if not key.startswith("norm.")}
    return {key: value for key, value in found.items() if key in wanted}


def _own_name(key: str) -> str:
    key = re.sub(r"^(resnet|convnext)\.", "", key)
    key = re.sub(r"^layernorm\.", "norm.", key)
    for theirs, ours in TORCHVISION:
        if re.match(theirs, key):
            # they count stages and layers from 1
            renamed = re.sub(theirs, ours, key)
            renamed = re.sub(r"stages\.(\d)", lambda n: f"stages.{int(n[1]) - 1}", renamed)
            return re.sub(r"\.layer\.(\d)", lambda n: f".layer.{int(n[1]) - 1}", renamed)
    return key


def _transformers(what: str) -> Any:
    with needs_extra(what, "train"):
        library: Any = import_module("transformers")  # by name: its thousands of types are none of mypy's business
    return library
