"""Tokens of a frozen backbone, computed once and kept on disk.

Where nothing of the backbone is trained, the same photo gives the same tokens at every step, so only the head need
run. Each photo has a few augmented versions, chosen among at random at each step; a version's changes depend on the
photo and the version's number alone, so runs with other seeds, other heads and other rates share one cache.

One file for each version of a photo: `patches` [rows, columns, d] and `scene` [d] as float16, named by everything that
decides them. Each is described by itself, so what a file holds does not depend on which others were missing, and a run
that is killed and goes on reads what it would have computed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float16
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as as_bytes
from torch import Tensor

from salad.datasets.training_place import View
from salad.files import write_whole
from salad.images.decode import DECODER
from salad.network.network import Network
from salad.network.tokens import Tokens
from salad.training.batches import BatchLoader, training_preprocessing
from salad.training.devices import combined_seed

Kept = dict[str, Float16[Tensor, "..."]]


class TokenCache:
    """Tokens by photo and version, from disk where they are there.

    Args:
        model: whose backbone makes them; it must not be trained meanwhile.
        batches: what reads, changes and normalises photos.
        folder: where they lie; several runs may share it, at the same time too.
    """

    def __init__(self, model: Network, batches: BatchLoader, *, folder: Path) -> None:
        self.model, self.batches, self.fabric = model, batches, batches.fabric
        self.folder = folder / self._settings()

    def parts(self, step: int, batch: Sequence[View]) -> list[Tokens]:
        """This process's slice of a step's batch, as tokens that pass through the head part after part."""
        recipe = self.batches.recipe
        # Drawn for the whole batch, so that a photo has the same version however many processes share the batch.
        chance = np.random.default_rng((recipe.seed, step, recipe.cache_versions))
        versions = chance.integers(recipe.cache_versions, size=len(batch)).tolist()
        mine = list(zip(self.batches.rank_slice(batch), self.batches.rank_slice(versions), strict=True))
        each = recipe.at_once or len(mine)
        return [self._stacked(mine[start : start + each]) for start in range(0, len(mine), each)]

    def _stacked(self, asked: Sequence[tuple[View, int]]) -> Tokens:
        kept = [self.kept(view, version) for view, version in asked]
        patches = torch.stack([each["patches"] for each in kept]).to(self.fabric.device).float()
        scenes = torch.stack([each["scene"] for each in kept]).to(self.fabric.device).float()
        grid = (patches.shape[1], patches.shape[2])
        return Tokens(patches.flatten(1, 2), scenes, grid, self.model.backbone.stride)

    def kept(self, view: View, version: int) -> Kept:
        """One version of a photo, described now if it never was."""
        name = self._name(view, version)
        path = self.folder / name[:2] / f"{name}.safetensors"
        try:
            return load_file(path)
        except (SafetensorError, OSError):  # not there, or damaged
            made = self._made(view, int(name[:12], 16))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, as_bytes(made))
        return made

    def _made(self, view: View, seed: int) -> Kept:
        """Describe one version; what is random about it is its own, and nobody else's is disturbed."""
        with torch.random.fork_rng(devices=[]), torch.no_grad(), self.fabric.autocast():
            torch.manual_seed(combined_seed(seed))
            self.model.backbone.eval()
            tokens = self.model.tokens(self.batches.changed([view]))
        patches = tokens.patches[0].view(*tokens.grid, -1)
        return {
            "patches": patches.to("cpu", torch.float16).contiguous(),
            "scene": tokens.cls[0].to("cpu", torch.float16).contiguous(),
        }

    def _name(self, view: View, version: int) -> str:
        try:  # size and time of change stand for the content: to hash every photo at every step would cost more
            there = view.path.stat()
            state = [there.st_size, there.st_mtime_ns]
        except OSError:  # another photo of its place stands in for it until it is back
            state = []
        decides = [str(view.path.absolute()), *state, view.mirrored, version]
        return hashlib.blake2b(json.dumps(decides).encode(), digest_size=16).hexdigest()

    def _settings(self) -> str:
        """Names what decides all files alike: the backbone, how photos are read and changed, the precision."""
        recipe = self.batches.recipe
        size = asdict(training_preprocessing(self.model, recipe))
        decides = [
            self.model.config.as_dict()["backbone"],
            size,
            DECODER,
            [recipe.augment, recipe.version],
            recipe.precision,
        ]
        digest = hashlib.blake2b(json.dumps(decides, sort_keys=True).encode(), digest_size=8)
        for key, weight in sorted(self.model.backbone.state_dict().items()):
            digest.update(key.encode())
            # As float64, so that the same numbers held in another precision are the same backbone.
            plain = weight.detach().to("cpu", torch.float64 if weight.is_floating_point() else torch.int64)
            digest.update(plain.contiguous().numpy().tobytes())
        return digest.hexdigest()
