"""The training loop: read it aloud.

A run lives in a folder: `log.jsonl` (one line a measurement), `last.ckpt` (to go on from after an interrupt) and,
in the end, `model/` in our own format. The n-th step depends on the seed and n alone, so a run that was
interrupted ends as it would have.
"""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from salad.data.places import TrainingPlace, View, batches, split
from salad.errors import MissingExtraError, ModelError
from salad.model.describer import Describer, build
from salad.model.weights import write_folder
from salad.train.augment import augmentation
from salad.train.choose import Shelf, precision_held_out
from salad.train.objective import multi_similarity
from salad.train.recipe import Precision, Preset, Recipe
from salad.train.start import start_backbone

Say = Callable[[str], None]
CHECKPOINT, LOG, MODEL = "last.ckpt", "log.jsonl", "model"


def train(
    preset: Preset,
    places: Sequence[TrainingPlace],
    *,
    to: Path,
    start: str | None = None,
    accelerator: str = "auto",
    say: Say = print,
) -> Path:
    """Train a model and write it to `to/model`.

    Args:
        preset: the model, where its backbone starts, and the recipe.
        places: what to learn from; the recipe's share of them is held out.
        to: the run's folder; a run found there goes on.
        start: other weights for the backbone than the preset's.
        accelerator: Fabric's word for where to run: `auto`, `cpu`, `gpu`, `mps`.
        say: takes a line whenever there is something to tell.

    Raises:
        MissingExtraError: the `train` extra is not installed.
        BenchmarkError: there are too few places.
        ModelError: `to` holds a run of another recipe.
    """
    recipe = preset.recipe
    learn, choose = split(places, held_out=recipe.held_out, seed=recipe.seed)
    say(f"{len(learn)} places to learn from, {len(choose)} held out to choose by")
    model = build(preset.model, seed=recipe.seed)
    start_backbone(model, preset.start if start is None else start)
    to.mkdir(parents=True, exist_ok=True)
    run = _Run(model, recipe, learn, choose, folder=to, accelerator=accelerator, say=say)
    run.steps()
    model.load_state_dict(run.best["weights"])
    return write_folder(model.cpu().eval(), to / MODEL, dtype=torch.float16, overwrite=True)


class _Run:
    """One run: its two stages are one walk over numbered steps."""

    def __init__(
        self,
        model: Describer,
        recipe: Recipe,
        learn: Sequence[TrainingPlace],
        choose: Sequence[TrainingPlace],
        *,
        folder: Path,
        accelerator: str,
        say: Say,
    ) -> None:
        self.model, self.recipe, self.learn, self.choose = model, recipe, learn, choose
        self.folder, self.say = folder, say
        self.fabric = _fabric(accelerator, recipe.precision)
        size = model.preprocessing.height, model.preprocessing.width
        self.augment, self.objective, self.shelf = augmentation(*size), multi_similarity(), Shelf(model)
        self.average = copy.deepcopy(model)
        self.best: dict[str, Any] = {"score": -1.0, "weights": self.average.state_dict()}
        self.step, self.began = 0, time.monotonic()

    def steps(self) -> None:
        """Both stages, from wherever the run stands."""
        saved = self._saved()
        if saved:
            self._take_up(saved)
        head, end = self.recipe.head_steps, self.recipe.head_steps + self.recipe.tune_steps
        for stage, first, last in (("head", 0, head), ("tune", head, end)):
            if self.step < last:
                within = (
                    saved is not None and first < self.step
                )  # at a stage's start its optimizer is a new one
                self._stage(stage, first, last, saved["optimizer"] if saved and within else None)

    def _take_up(self, saved: dict[str, Any]) -> None:
        self.model.load_state_dict(saved["model"])
        self.average.load_state_dict(saved["average"])
        self.best, self.step = saved["best"], saved["step"]
        self.say(f"going on from step {self.step}")

    def _stage(self, stage: str, first: int, end: int, momenta: dict[str, Any] | None) -> None:
        self.model.backbone.train_last(0 if stage == "head" else self.recipe.tuned_blocks)
        module, optimizer = self.fabric.setup(self.model, _optimizer(self.model, self.recipe))
        self.average.to(self.fabric.device)
        if momenta:
            optimizer.load_state_dict(momenta)
        feed = batches(
            self.learn,
            per_batch=self.recipe.places,
            views=self.recipe.views,
            seed=self.recipe.seed,
            start=self.step,
        )
        while self.step < end:
            factor = rate_factor(self.step - first, end - first, self.recipe)
            for group in optimizer.param_groups:
                group["lr"] = group["rate"] * factor
            loss = self._learn(module, optimizer, next(feed))
            self.step += 1
            if self.step % self.recipe.measure_every == 0 or self.step == end:
                self._tell(stage, loss, optimizer)

    def _learn(self, module: nn.Module, optimizer: torch.optim.Optimizer, batch: Sequence[View]) -> float:
        torch.manual_seed(self.recipe.seed * 1_000_003 + self.step)
        module.train()
        images = self._views(batch)
        labels = torch.tensor([view.label for view in batch], device=self.fabric.device)
        loss = self.objective(module(images).float(), labels)
        self.fabric.backward(loss)
        self.fabric.clip_gradients(module, optimizer, max_norm=1.0, error_if_nonfinite=False)
        optimizer.step()
        optimizer.zero_grad()
        self._average()
        return float(loss.detach())

    @torch.no_grad()
    def _average(self) -> None:
        """Keep a running mean of the weights: it wanders less than the weights of any one step."""
        decay = min(self.recipe.average, self.step / (self.step + 10))  # a young mean soon forgets its start
        for mean, weight in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mean.lerp_(weight, 1 - decay)

    def _views(self, batch: Sequence[View]) -> Float[Tensor, "batch 3 height width"]:
        photos = self.shelf.photos([view.path for view in batch]).to(self.fabric.device)
        mirrored = torch.tensor([view.mirrored for view in batch], device=self.fabric.device)
        photos = torch.where(mirrored[:, None, None, None], photos.flip(-1), photos)
        with torch.no_grad():
            seen: Tensor = self.augment(photos.float() / 255).clamp(0, 1)
            return (seen - self.model.mean) / self.model.std

    def _tell(self, stage: str, loss: float, optimizer: torch.optim.Optimizer) -> None:
        told: dict[str, Any] = {
            "step": self.step,
            "stage": stage,
            "loss": round(loss, 4),
            "seconds": round(time.monotonic() - self.began, 1),
        }
        if self.choose:
            told["held_out"] = precision_held_out(self.average, self.choose, self.shelf)
        score = (
            told["held_out"]["mean"] if self.choose else float(self.step)
        )  # nothing to choose by: the last
        if score > self.best["score"]:
            self.best = {"score": score, "weights": copy.deepcopy(self.average.state_dict())}
        with (self.folder / LOG).open("a", encoding="utf-8") as log:
            log.write(json.dumps(told) + "\n")
        self.say(json.dumps(told))
        self._save(optimizer)

    def _save(self, optimizer: torch.optim.Optimizer) -> None:
        state = {
            "recipe": asdict(self.recipe),
            "architecture": self.model.config.as_dict(),
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "best": self.best,
            "optimizer": optimizer.state_dict(),
        }
        draft = self.folder / f"{CHECKPOINT}.part"
        torch.save(state, draft)
        draft.replace(self.folder / CHECKPOINT)

    def _saved(self) -> dict[str, Any] | None:
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return None
        saved: dict[str, Any] = torch.load(path, map_location=self.fabric.device, weights_only=True)
        for key, mine in (("recipe", asdict(self.recipe)), ("architecture", self.model.config.as_dict())):
            if saved.get(key) != mine:
                raise ModelError(f"{path} belongs to a run of another {key}; choose another folder with --to")
        return saved


def rate_factor(step: int, steps: int, recipe: Recipe) -> float:
    """What the learning rate is multiplied by at a step of its stage: up, then linearly down."""
    rising = min(1.0, (step + 1) / max(1, recipe.warmup))
    falling = 1 - (1 - recipe.last) * step / max(1, steps)
    return rising * falling


def _optimizer(model: Describer, recipe: Recipe) -> torch.optim.Optimizer:
    groups = [
        {"params": list(_trained(part)), "rate": rate}
        for part, rate in ((model.aggregator, recipe.head_rate), (model.backbone, recipe.trunk_rate))
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], weight_decay=recipe.weight_decay)


def _trained(part: nn.Module) -> Iterator[nn.Parameter]:
    return (weight for weight in part.parameters() if weight.requires_grad)


def _fabric(accelerator: str, precision: Precision) -> Any:
    try:
        from lightning_fabric import Fabric
    except ImportError as error:
        raise MissingExtraError("training", "train") from error
    return Fabric(accelerator=accelerator, devices=1, precision=precision)
