"""From places to what passes through the model: the n-th batch, this process's slice of it, changed and normalised."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor

from salad.datasets.samplers import CliqueSampler, MixedSampler, OneCitySampler, Sampler
from salad.datasets.training_place import TrainingPlace, View
from salad.errors import BenchmarkError, ModelError, PhotoError
from salad.images.decode import decode
from salad.network.config import Preprocessing
from salad.network.network import Network
from salad.training.augment import CUTTING, augmentation
from salad.training.devices import rank_slice
from salad.training.recipe import Recipe

Pixels = UInt8[np.ndarray, "height width 3"]

_MEGA = 1_000_000
_THREADS = 8  # at most; decoding leaves Python's lock, so that as many cores work


class ImageCache:
    """Photos by their paths, as bytes of a model's size: read ahead of their turn, kept while there is memory.

    A photo that cannot be read is remembered and never shown as something else: another photo of its place stands
    in. Use it from one thread; it has its own for reading.

    Args:
        preprocessing: to what size photos are squeezed, and how.
        megabytes: memory for keeping photos. What comes first stays: over an epoch every photo is as likely
            to come again as any other, so nothing is gained by putting one out for another.

    Attributes:
        broken: a sentence for each photo that could not be read.
    """

    def __init__(self, preprocessing: Preprocessing, *, megabytes: int = 4096) -> None:
        self.preprocessing = preprocessing
        self.broken: dict[Path, str] = {}
        # Photos, not bytes, since all are of one size: three bytes a pixel.
        self._room = megabytes * _MEGA // (3 * preprocessing.height * preprocessing.width)
        self._kept: dict[Path, Pixels] = {}
        self._now: dict[Path, Future[Pixels]] = {}  # of the batch being fetched
        self._ahead: deque[dict[Path, Future[Pixels]]] = deque()  # of the two batches last expected
        self._pool = ThreadPoolExecutor(min(_THREADS, os.cpu_count() or 1), thread_name_prefix="salad-photos")
        self._reported = 0

    def array(self, path: Path) -> Pixels:
        """One photo as bytes.

        Raises:
            PhotoError: If it cannot be read; `broken` knows it from then on.
        """
        if path in self._kept:
            return self._kept[path]
        if path in self.broken:
            raise PhotoError(self.broken[path])
        try:
            pixels = self._coming(path).result()
        except PhotoError as error:
            self.broken[path] = str(error)
            raise
        if len(self._kept) < self._room:
            self._kept[path] = pixels
        return pixels

    def photos(self, views: Sequence[View]) -> UInt8[Tensor, "photos 3 height width"]:
        """The photos of a batch as one tensor; another of its place stands in for one that cannot be read.

        Which one depends on the files alone: the next of the place, in a circle, that the batch does not show
        yet, or any of them where it shows all.

        Raises:
            BenchmarkError: If no photo of a place can be read.
        """
        self._now = self._read_missing(views)
        shown = {view.path for view in views}
        seen: dict[Path, Pixels] = {}
        rows = []
        for view in views:
            for path in _candidates(view, shown):
                if path not in seen:
                    with suppress(PhotoError):
                        seen[path] = self.array(path)
                if path in seen:
                    break
            else:
                raise BenchmarkError(
                    f"no photo of the place {view.place.name} in {view.place.city} can be read; the first: "
                    f"{self.broken[view.path]}"
                )
            shown.add(path)
            rows.append(seen[path])
        return torch.from_numpy(np.stack(rows)).permute(0, 3, 1, 2)

    def prefetch(self, views: Sequence[View]) -> None:
        """Begin to read what a batch to come shows; what was asked for before the last call is let go."""
        while len(self._ahead) > 1:
            for future in self._ahead.popleft().values():
                future.cancel()
        self._ahead.append(self._read_missing(views))

    def newly_unreadable(self) -> str:
        """One sentence on the photos that could not be read since this was last asked; empty where there are none."""
        fresh = list(self.broken.values())[self._reported :]
        self._reported = len(self.broken)
        if not fresh:
            return ""
        what = "1 photo cannot be read" if len(fresh) == 1 else f"{len(fresh)} photos cannot be read"
        return f"{what}, and others of their places stand in; the first: {fresh[0]}"

    def close(self) -> None:
        """Let go of the threads; what is kept stays."""
        self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _read_missing(self, views: Sequence[View]) -> dict[Path, Future[Pixels]]:
        """Begin to read what of these photos is neither kept nor on its way."""
        known: tuple[Mapping[Path, object], ...] = (self._kept, self.broken, self._now, *self._ahead)
        wanted = dict.fromkeys(view.path for view in views)
        return {path: self._read(path) for path in wanted if not any(path in part for part in known)}

    def _coming(self, path: Path) -> Future[Pixels]:
        for begun in (self._now, *self._ahead):
            if path in begun:
                return begun.pop(path)
        return self._read(path)

    def _read(self, path: Path) -> Future[Pixels]:
        to = self.preprocessing
        return self._pool.submit(decode, path, to.height, to.width, to.resample)


def _candidates(view: View, shown: set[Path]) -> Iterator[Path]:
    """A view's photo, and those of its place that may stand in for it, one after another."""
    yield view.path
    photos = view.place.photos
    number = photos.index(view.path)
    others = photos[number + 1 :] + photos[:number]
    yield from (path for path in others if path not in shown)
    yield from others


Item = TypeVar("Item")


class BatchLoader:
    """The batches of a run. The n-th depends on the seed and n alone; the changes, on torch's seed.

    Args:
        model: whose photos' size and normalisation are taken.
        recipe: how batches are drawn and photos changed.
        places: what `sampler` draws from.
        sampler: what draws.
        fabric: which process this is, and where its numbers live.

    Attributes:
        images: photos at the size of training.
        images_in_use: photos at the size the model is used with, for measuring it.

    Raises:
        MissingExtraError: If the `train` extra is not installed.
    """

    def __init__(
        self,
        model: Network,
        recipe: Recipe,
        places: Sequence[TrainingPlace],
        *,
        sampler: Sampler,
        fabric: Any,
    ) -> None:
        self.model, self.recipe, self.places, self.fabric = model, recipe, places, fabric
        self.sampler = sampler
        size, full = training_preprocessing(model, recipe), model.config.preprocessing
        self.augment = augmentation(recipe.augment, size.height, size.width)
        self.augment_full = augmentation(recipe.augment, full.height, full.width)
        self.images_in_use = ImageCache(full)
        # Changes that cut the photo they make out of a larger one are given the larger one, and one cache does.
        shared = size == full or recipe.augment in CUTTING
        self.images = self.images_in_use if shared else ImageCache(size)
        _, end = count_steps(recipe, sampler)
        self.full_from = end - recipe.full_steps if recipe.size else end

    def use_cliques(self, cliques: Sequence[Sequence[int]]) -> None:
        """From now on, fill batches with these cliques of place numbers."""
        self.sampler = build_sampler(self.recipe, self.places, cliques=cliques)

    def batch(self, step: int) -> list[View]:
        """All photos of a step's batch, those of a place together."""
        return self.sampler.batch(step)

    def labels(self, batch: Sequence[View]) -> Int64[Tensor, " batch"]:
        """Which place each photo of the whole batch shows."""
        return torch.tensor([view.label for view in batch], device=self.fabric.device)

    def rank_slice(self, batch: Sequence[Item]) -> Sequence[Item]:
        """What this process reads of a batch: nothing else is opened here."""
        return batch[rank_slice(len(batch), self.fabric.global_rank, self.fabric.world_size)]

    def parts(self, step: int, batch: Sequence[View]) -> list[Tensor]:
        """This process's slice, as images that pass through the model one part after another."""
        images = self.changed(self.rank_slice(batch), full=step >= self.full_from)
        following = self.images_in_use if step + 1 >= self.full_from else self.images
        following.prefetch(self.rank_slice(self.batch(step + 1)))  # read while this one is learnt from
        return list(torch.split(images, self.recipe.at_once or len(images)))

    def changed(self, views: Sequence[View], *, full: bool = False) -> Float[Tensor, "views 3 height width"]:
        """Photos mirrored where their place is, augmented and normalised; of the size in use where `full`."""
        cache, augment = (self.images_in_use, self.augment_full) if full else (self.images, self.augment)
        photos = cache.photos(views).to(self.fabric.device)
        # Before anything else changes: mirrored, a place is another place and has a label of its own.
        mirrored = torch.tensor([view.mirrored for view in views], device=self.fabric.device)
        photos = torch.where(mirrored[:, None, None, None], photos.flip(-1), photos)
        with torch.no_grad():
            seen: Tensor = augment(photos.float() / 255)  # in 0..1 again: `augmentation` ends with that
            return (seen - self.model.mean) / self.model.std

    def newly_unreadable(self) -> list[str]:
        """A sentence on the photos of each size that could not be read since this was last asked."""
        caches = dict.fromkeys((self.images, self.images_in_use))  # they may be one
        return [sentence for cache in caches if (sentence := cache.newly_unreadable())]

    def close(self) -> None:
        """Let go of what reads photos."""
        self.images.close()
        self.images_in_use.close()


def training_preprocessing(model: Network, recipe: Recipe) -> Preprocessing:
    """How photos are squeezed in training: the model's own way, to the recipe's size where it has one."""
    if recipe.size is None:
        return model.config.preprocessing
    return replace(model.config.preprocessing, height=recipe.size, width=recipe.size)


def build_sampler(recipe: Recipe, places: Sequence[TrainingPlace], *, cliques: Sequence[Sequence[int]] = ()) -> Sampler:
    """How the recipe draws its batches; mixed ones stand in until cliques are known.

    Raises:
        BenchmarkError: If there are fewer places than a batch needs.
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


def count_steps(recipe: Recipe, sampler: Sampler) -> tuple[int, int]:
    """Steps of the first stage, and of both together.

    Raises:
        ModelError: If the recipe counts epochs, and its sampler does not.
    """
    if recipe.epochs is None:
        return recipe.head_steps, recipe.head_steps + recipe.tune_steps
    per_epoch = getattr(sampler, "per_epoch", None)
    if per_epoch is None:
        raise ModelError(
            f"epochs are counted by the sampler one-city alone, and this recipe's is {recipe.sampler}: give "
            "tune_steps in place of epochs"
        )
    return recipe.head_steps, recipe.head_steps + recipe.epochs * int(per_epoch)


def check_processes(recipe: Recipe, processes: int) -> None:
    """Refuse a batch that leaves a process without a photo.

    Raises:
        ModelError: If it does.
    """
    if recipe.batch < processes:
        raise ModelError(
            f"a batch of {recipe.places} places x {recipe.views} photos leaves some of {processes} processes "
            "without any: give more places or views, or fewer devices"
        )
