"""The training loop: read it aloud.

A run lives in a folder (`runfolder`). The n-th step depends on the seed and n alone, so a run that was interrupted, or
killed, ends as it would have. On several devices every process walks the same steps, each with its share of the batch;
the first one alone speaks, measures and writes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

from salad.datasets.training_place import TrainingPlace, View
from salad.models.describer import build
from salad.training import checkpoint
from salad.training.batches import BatchLoader, divided, sampler_of, steps_of
from salad.training.checkpoint import State
from salad.training.devices import launched, step_seed
from salad.training.gradient_cache import Part, learn
from salad.training.logger import Record, Say
from salad.training.mining import mine
from salad.training.optim import drift, multi_similarity, optimizer_of, rate_factor, set_rates
from salad.training.recipe import Preset, Recipe
from salad.training.start import fit, needs_fitting, start_backbone
from salad.training.token_cache import TokensCache
from salad.training.validation import Judge, by_places_held_out

Progress = Callable[[int, int | None], None]
TOKENS = "tokens"


def train(
    preset: Preset,
    places: Sequence[TrainingPlace],
    *,
    to: Path,
    start: str | None = None,
    accelerator: str = "auto",
    devices: int = 1,
    nodes: int = 1,
    judge: Judge | None = None,
    resume: bool = False,
    board: bool = False,
    tokens: Path | None = None,
    progress: Progress | None = None,
    say: Say = print,
) -> Path:
    """Train a model; the best weights go to `to/model`, the last ones to `to/last`.

    Args:
        preset: the model, where its backbone starts, and the recipe.
        places: what to learn from; the recipe's share of them is held out.
        to: the run's folder; a run found there goes on.
        start: other weights for the backbone than the preset's.
        accelerator: Fabric's word for where to run: `auto`, `cpu`, `gpu`, `mps`.
        devices: devices of each machine; each takes a share of every batch.
        nodes: machines; start the same command on each.
        judge: what measures the model, in place of its precision on the places held out.
        resume: insist on a run in `to` that has not ended.
        board: draw curves for TensorBoard.
        tokens: where tokens are cached, if the recipe says so; several runs may share it. By default in `to`.
        progress: told how many steps are made, and of how many.
        say: takes a line whenever there is something to tell.

    Returns:
        The folder of the best model.

    Raises:
        MissingExtraError: the `train` extra is not installed.
        BenchmarkError: there are too few places, or none of a place's photos can be read.
        ModelError: `to` holds another run, or the model, the recipe and the devices do not fit together.
        WeightsError: the backbone cannot start from `start`.
        TrainingError: the loss is no number any more; a checkpoint cannot be read or written; or there is
            nothing to resume. What was saved before stays.
    """
    recipe, start = preset.recipe, preset.start if start is None else start
    divided(recipe, devices * nodes)
    learnt, choose = recipe.split(places)
    model = build(preset.model, seed=recipe.seed)
    start_backbone(model, start)
    sampler = sampler_of(recipe, learnt)
    head, end = steps_of(recipe, sampler)
    judged_by = "benchmark" if judge else "held_out"
    identity = checkpoint.identity(recipe, preset.model, places, start=start, judge=judged_by)
    saved = checkpoint.take_up(to, identity)
    if resume and nodes == 1:  # before other processes are started, which would say the same
        checkpoint.insist(to, saved, steps=end)
    fabric = launched(accelerator, recipe.precision, devices=devices, nodes=nodes)
    first = fabric.is_global_zero
    saved = fabric.broadcast(saved)  # what the first process wrote may lie on another machine's disk
    if resume and nodes > 1:
        checkpoint.insist(to, saved, steps=end)
    with closing(BatchLoader(model, recipe, learnt, sampler=sampler, fabric=fabric)) as feed:
        if judge is None and choose:
            judge = by_places_held_out(choose, feed.in_use)
        record = Record(
            to,
            identity,
            judge=judge,
            tell=say if first else _silence,
            first=first,
            processes=fabric.world_size,
        )
        record.tell(f"{len(learnt)} places to learn from, {len(choose)} held out to choose by")
        if saved is None and needs_fitting(model):
            record.tell("fitting the aggregator to the photos before its first step")
            photos = [photo for place in learnt for photo in place.photos]
            fit(model, photos, seed=recipe.seed, passed_over=lambda error: record.tell(f"left out: {error}"))
        run = _Run(State(model, tuned_share=recipe.tuned_share), feed, record, tokens=tokens or to / TOKENS)
        run.begin(saved, resolved=checkpoint.resolved(preset, places, start=start, steps=end), board=board)
        run.walk(head, end, progress=progress or _no_progress)
        return record.end(run.state)


class _Stage(NamedTuple):
    """A stretch of steps over which the same weights are trained by one optimizer."""

    name: str
    first: int
    end: int
    module: nn.Module
    optimizer: torch.optim.Optimizer
    cached: bool
    parts: Callable[[int, Sequence[View]], Sequence[Part]]


class _Run:
    """One run: its two stages are one walk over numbered steps."""

    def __init__(self, state: State, feed: BatchLoader, record: Record, *, tokens: Path) -> None:
        self.state, self.feed, self.record, self.tokens = state, feed, record, tokens
        self.recipe: Recipe = feed.recipe
        self.fabric, self.objective = feed.fabric, multi_similarity()

    def begin(self, saved: dict[str, Any] | None, *, resolved: dict[str, Any], board: bool) -> None:
        """Stand at the first step, or where the run stood when it was saved."""
        if saved:
            self.state.take_up(saved)
            if self.state.cliques:
                self.feed.use_cliques(self.state.cliques)
            if self.state.scaler:
                self.fabric.strategy.precision.load_state_dict(self.state.scaler)
        self.state.to(self.fabric.device)
        self.record.begin(self.state, saved, resolved=resolved, board=board)

    def walk(self, head: int, end: int, *, progress: Progress) -> None:
        """Both stages, from wherever the run stands."""
        for name, first, last, blocks in (
            ("head", 0, head, 0),
            ("tune", head, end, self.recipe.tuned_blocks),
        ):
            if self.state.step < last:
                if name == "tune" and self.state.step == first:
                    self.state.remember()
                stage = self._stage(name, first, last, blocks)
                while self.state.step < last:
                    self._step(stage)
                    if self.record.first:
                        progress(self.state.step, end)

    def _stage(self, name: str, first: int, end: int, blocks: int) -> _Stage:
        model = self.state.model
        model.backbone.train_last(blocks)
        cached = self.recipe.cached(blocks)
        feed = TokensCache(model, self.feed, folder=self.tokens) if cached else self.feed
        module, optimizer = self.fabric.setup(
            model.aggregator if cached else model, optimizer_of(model, self.recipe)
        )
        if first < self.state.step and self.state.momenta:  # at a stage's start its optimizer is a new one
            optimizer.load_state_dict(self.state.momenta)
        self.state.momenta = None
        return _Stage(name, first, end, module, optimizer, cached, feed.parts)

    def _step(self, stage: _Stage) -> None:
        state, recipe = self.state, self.recipe
        self._mine()
        set_rates(stage.optimizer, rate_factor(state.step - stage.first, stage.end - stage.first, recipe))
        loss = self._learn(stage, self.feed.batch(state.step))
        drift(state.average, state.model, decay=recipe.average, step=state.step)
        state.step += 1
        self.record.draw(state, stage.optimizer, loss)
        measured = state.step % recipe.measure_every == 0 or state.step == stage.end
        if measured:
            self._tell_news()
            self.record.measure(state, stage=stage.name, loss=loss)
        if measured or state.step % recipe.save_every == 0:
            self.record.save(state, stage.optimizer, self.fabric.strategy.precision.state_dict())
            self.fabric.barrier()

    def _learn(self, stage: _Stage, batch: Sequence[View]) -> float:
        seed = step_seed(self.recipe.seed, self.state.step, self.fabric.global_rank)
        torch.manual_seed(seed)
        stage.module.train()
        parts = stage.parts(self.state.step, batch)
        if stage.cached:  # whatever had to be described first
            torch.manual_seed(seed)
        labels = self.feed.labels(batch)
        loss = float(
            learn(self.fabric, stage.module, parts=parts, labels=labels, objective=self.objective, seed=seed)
        )
        length = self.fabric.clip_gradients(
            stage.module,
            stage.optimizer,
            max_norm=self.recipe.clip or math.inf,
            error_if_nonfinite=False,
        )
        self._insist(loss, float(length), batch)
        stage.optimizer.step()
        stage.optimizer.zero_grad()
        return loss

    def _insist(self, loss: float, length: float, batch: Sequence[View]) -> None:
        """Stop where there is nothing sound to learn; half precision may overshoot, and then lowers its scale."""
        scaler = getattr(self.fabric.strategy.precision, "scaler", None)
        scaling = scaler is not None and float(scaler.get_scale()) >= 1
        if not math.isfinite(loss):
            raise self.record.stop(self.state, batch, f"the loss is {loss}")
        if not math.isfinite(length) and not scaling:
            raise self.record.stop(self.state, batch, f"the gradient's length is {length}")

    def _mine(self) -> None:
        """Where the recipe wants batches of places that look alike, look for them every so often."""
        step, recipe, feed = self.state.step, self.recipe, self.feed
        if recipe.sampler != "cliques" or step == 0 or step % recipe.mine_every:
            return
        cliques: list[list[int]] = []
        if self.record.first:
            cliques = mine(
                self.state.average, feed.places, feed.in_use, folder=self.record.folder, size=recipe.clique
            )
            self.record.tell(f"{len(cliques)} cliques of places that look alike at step {step}")
        self.state.cliques = self.fabric.broadcast(cliques)
        feed.use_cliques(self.state.cliques)

    def _tell_news(self) -> None:
        for news in self.feed.news():
            self.record.tell(news)


def _silence(_: str) -> None:
    """What the other processes say."""


def _no_progress(_: int, __: int | None) -> None:
    """Nobody watches."""
