"""From places to what passes through the model: the n-th batch, this process's share of it, changed and normalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from salad.data.places import TrainingPlace, View
from salad.data.sampling import CliqueSampler, MixedSampler, OneCitySampler, Sampler
from salad.errors import ModelError
from salad.model.describer import Describer
from salad.train.augment import CUTTING, augmentation
from salad.train.launching import share_of
from salad.train.recipe import Recipe
from salad.train.shelf import Shelf

One = TypeVar("One")


class Feed:
    """The batches of a run. The n-th depends on the seed and n alone; the changes, on torch's seed.

    Args:
        model: whose photos' size and normalisation are taken.
        recipe: how batches are drawn and photos changed.
        places: what `sampler` draws from.
        sampler: what draws.
        fabric: which process this is, and where its numbers live.

    Attributes:
        shelf: photos at the size of training.
        in_use: photos at the size the model is used with, for measuring it.

    Raises:
        MissingExtraError: the `train` extra is not installed.
    """

    def __init__(
        self,
        model: Describer,
        recipe: Recipe,
        places: Sequence[TrainingPlace],
        *,
        sampler: Sampler,
        fabric: Any,
    ) -> None:
        self.model, self.recipe, self.places, self.fabric = model, recipe, places, fabric
        self.sampler = sampler
        size, full = preprocessing_of(model, recipe), model.preprocessing
        self.augment = augmentation(recipe.augment, size.height, size.width)
        self.augment_full = augmentation(recipe.augment, full.height, full.width)
        self.in_use = Shelf(full)
        self.shelf = self.in_use if size == full or recipe.augment in CUTTING else Shelf(size)
        _, end = steps_of(recipe, sampler)
        self.full_from = end - recipe.full_steps if recipe.size else end

    def use_cliques(self, cliques: Sequence[Sequence[int]]) -> None:
        """From now on, fill batches with these cliques of place numbers."""
        self.sampler = sampler_of(self.recipe, self.places, cliques=cliques)

    def batch(self, step: int) -> list[View]:
        """All photos of a step's batch, those of a place together."""
        return self.sampler.batch(step)

    def labels(self, batch: Sequence[View]) -> Int64[Tensor, " batch"]:
        """Which place each photo of the whole batch shows."""
        return torch.tensor([view.label for view in batch], device=self.fabric.device)

    def share(self, batch: Sequence[One]) -> Sequence[One]:
        """What this process reads of a batch: nothing else is opened here."""
        return batch[share_of(len(batch), self.fabric.global_rank, self.fabric.world_size)]

    def parts(self, step: int, batch: Sequence[View]) -> list[Tensor]:
        """This process's share, as images that pass through the model one part after another."""
        images = self.images(self.share(batch), full=step >= self.full_from)
        following = self.in_use if step + 1 >= self.full_from else self.shelf
        following.expect(self.share(self.batch(step + 1)))
        return list(torch.split(images, self.recipe.at_once or len(images)))

    def images(self, views: Sequence[View], *, full: bool = False) -> Float[Tensor, "views 3 height width"]:
        """Photos mirrored where their place is, changed and normalised; of the size in use where `full`."""
        shelf, augment = (self.in_use, self.augment_full) if full else (self.shelf, self.augment)
        photos = shelf.photos(views).to(self.fabric.device)
        mirrored = torch.tensor([view.mirrored for view in views], device=self.fabric.device)
        photos = torch.where(mirrored[:, None, None, None], photos.flip(-1), photos)
        with torch.no_grad():
            seen: Tensor = augment(photos.float() / 255).clamp(0, 1)
            return (seen - self.model.mean) / self.model.std

    def news(self) -> list[str]:
        """What the shelves found broken since they were last asked."""
        return [told for told in (shelf.news() for shelf in dict.fromkeys((self.shelf, self.in_use))) if told]

    def close(self) -> None:
        """Let go of what reads photos."""
        self.shelf.close()
        self.in_use.close()


def preprocessing_of(model: Describer, recipe: Recipe) -> Any:
    """How photos are squeezed in training: the model's own way, to the recipe's size where it has one."""
    if recipe.size is None:
        return model.preprocessing
    return replace(model.preprocessing, height=recipe.size, width=recipe.size)


def sampler_of(
    recipe: Recipe, places: Sequence[TrainingPlace], *, cliques: Sequence[Sequence[int]] = ()
) -> Sampler:
    """How the recipe draws its batches; mixed ones stand in until cliques are known.

    Raises:
        BenchmarkError: there are fewer places than a batch needs.
    """
    settings: dict[str, Any] = {
        "per_batch": recipe.places,
        "views": recipe.views,
        "seed": recipe.seed,
        "mirror": recipe.mirror,
    }
    if recipe.sampler == "one-city":
        return OneCitySampler(places, **settings)
    if cliques:
        return CliqueSampler(places, cliques=cliques, **settings)
    return MixedSampler(places, **settings)


def steps_of(recipe: Recipe, sampler: Sampler) -> tuple[int, int]:
    """Steps of the first stage, and of both together."""
    if recipe.epochs is None:
        return recipe.head_steps, recipe.head_steps + recipe.tune_steps
    per_epoch = getattr(sampler, "per_epoch", None)
    if per_epoch is None:
        raise ModelError(
            f"epochs are counted by the sampler one-city alone, and this recipe's is {recipe.sampler}: give "
            "tune_steps in place of epochs"
        )
    return recipe.head_steps, recipe.head_steps + recipe.epochs * int(per_epoch)


def divided(recipe: Recipe, processes: int) -> None:
    """Refuse a batch that leaves a process without a photo.

    Raises:
        ModelError: it does.
    """
    if recipe.batch < processes:
        raise ModelError(
            f"a batch of {recipe.places} places x {recipe.views} photos leaves some of {processes} processes "
            "without any: give more places or views, or fewer devices"
        )
