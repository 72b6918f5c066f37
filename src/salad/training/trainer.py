"""The training loop: read it aloud, from the top.

A run lives in a folder (see `checkpoint`). The n-th step depends on the seed and n alone, so a run that was
interrupted, or killed, ends as it would have. On several devices every process walks the same steps, each with its
part of the batch; the first one alone speaks, measures and writes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import nn

from salad.datasets.training_place import TrainingPlace, View
from salad.models.describer import Describer
from salad.network.network import build
from salad.training import checkpoint
from salad.training.batches import BatchLoader, build_sampler, check_processes, count_steps
from salad.training.checkpoint import TrainingState
from salad.training.devices import launch_fabric, step_seed
from salad.training.gradient_cache import Part, backward_in_parts
from salad.training.logger import RunLogger, Say
from salad.training.loss import multi_similarity
from salad.training.mining import mine
from salad.training.optim import build_optimizer, learning_rate_factor, set_learning_rates, update_average
from salad.training.recipe import Preset, Recipe
from salad.training.start import start_backbone
from salad.training.token_cache import TokenCache
from salad.training.validation import Judge, precision_held_out
from salad.training.vocabulary import fit, needs_fitting

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
        places: what to learn from; the recipe's fraction of them is held out.
        to: the run's folder; a run found there goes on.
        start: other weights for the backbone than the preset's.
        accelerator: Fabric's word for where to run: `auto`, `cpu`, `gpu`, `mps`.
        devices: devices of each machine; each takes a part of every batch.
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
        MissingExtraError: If the `train` extra is not installed.
        BenchmarkError: If there are too few places, or none of a place's photos can be read.
        ModelError: If `to` holds another run, or the model, the recipe and the devices do not fit together.
        WeightsError: If the backbone cannot start from `start`.
        TrainingError: If the loss is no number any more, a checkpoint cannot be read or written, or there is
            nothing to resume. What was saved before stays.
    """
    recipe, start = preset.recipe, preset.start if start is None else start
    check_processes(recipe, devices * nodes)
    learn_from, choose_by = recipe.split(places)
    model = build(preset.model, seed=recipe.seed)
    start_backbone(model, start)
    sampler = build_sampler(recipe, learn_from)
    head_end, end = count_steps(recipe, sampler)

    # Whatever is wrong with the folder is said before a process is started or a byte written.
    judged_by = "benchmark" if judge else "held_out"
    identity = checkpoint.run_identity(recipe, preset.model, places, start=start, judge=judged_by)
    saved = checkpoint.load_checkpoint(to, identity)
    if resume and nodes == 1:  # before other processes are started, which would say the same
        checkpoint.require_unfinished(to, saved, steps=end)
    fabric = launch_fabric(accelerator, recipe.precision, devices=devices, nodes=nodes)
    saved = fabric.broadcast(saved)  # what the first process wrote may lie on another machine's disk
    if resume and nodes > 1:
        checkpoint.require_unfinished(to, saved, steps=end)

    with closing(BatchLoader(model, recipe, learn_from, sampler=sampler, fabric=fabric)) as batches:
        if judge is None and choose_by:
            judge = partial(precision_held_out, places=choose_by, images=batches.images_in_use)
        first, processes = fabric.is_global_zero, fabric.world_size
        logger = RunLogger(to, identity, judge=judge, say=say, first=first, processes=processes)
        logger.say(f"{len(learn_from)} places to learn from, {len(choose_by)} held out to choose by")
        if saved is None and needs_fitting(model):  # a run that goes on has its clusters in the checkpoint
            logger.say("fitting the aggregator to the photos before its first step")
            photos = [photo for place in learn_from for photo in place.photos]
            fit(model, photos, seed=recipe.seed, passed_over=lambda error: logger.say(f"left out: {error}"))
        state = TrainingState(model, tuned_share=recipe.tuned_share)
        trainer = _Trainer(state, batches, logger, tokens=tokens or to / TOKENS)
        config = checkpoint.run_config(preset, places, start=start, steps=end)
        trainer.begin(saved, config=config, board=board)
        trainer.run(head_end, end, progress=progress)
        return logger.end(state)


@dataclass(frozen=True, slots=True)
class _Stage:
    """A stretch of steps over which the same weights are trained by one optimizer.

    Args:
        name: `head` or `tune`, as the log has it.
        first: the number of its first step.
        end: the number after that of its last.
        module: what runs, set up by Fabric: the model, or its aggregator alone.
        optimizer: of the weights trained.
        cached: whether the module's input are tokens kept on disk.
        parts: a step's batch as what passes through the module, one part after another.
    """

    name: str
    first: int
    end: int
    module: nn.Module
    optimizer: torch.optim.Optimizer
    cached: bool
    parts: Callable[[int, Sequence[View]], Sequence[Part]]


class _Trainer:
    """Walks the numbered steps of a run's two stages, from wherever the run stands."""

    def __init__(self, state: TrainingState, batches: BatchLoader, logger: RunLogger, *, tokens: Path) -> None:
        self.state, self.batches, self.logger, self.tokens = state, batches, logger, tokens
        self.recipe: Recipe = batches.recipe
        self.fabric, self.objective = batches.fabric, multi_similarity()

    def begin(self, saved: dict[str, Any] | None, *, config: dict[str, Any], board: bool) -> None:
        """Stand at the first step, or where the run stood when it was saved."""
        if saved:
            self.state.load_state_dict(saved)
            if self.state.cliques:
                self.batches.use_cliques(self.state.cliques)
            if self.state.scaler:
                self.fabric.strategy.precision.load_state_dict(self.state.scaler)
        self.state.to(self.fabric.device)
        self.logger.begin(self.state, saved, config=config, board=board)

    def run(self, head_end: int, end: int, *, progress: Progress | None) -> None:
        """The head alone, then the last blocks of the backbone with it."""
        state = self.state
        for name, first, last, blocks in (
            ("head", 0, head_end, 0),
            ("tune", head_end, end, self.recipe.tuned_blocks),
        ):
            if state.step >= last:
                continue
            if name == "tune" and state.step == first:
                state.remember_before_tuning()
            stage = self._begin_stage(name, first, last, blocks)
            while state.step < last:
                self._step(stage)
                if progress and self.logger.first:
                    progress(state.step, end)

    def _begin_stage(self, name: str, first: int, end: int, blocks: int) -> _Stage:
        model = self.state.model
        model.backbone.train_last(blocks)
        cached = self.recipe.cached(blocks)
        source = TokenCache(model, self.batches, folder=self.tokens) if cached else self.batches
        module, optimizer = self.fabric.setup(
            model.aggregator if cached else model, build_optimizer(model, self.recipe)
        )
        if first < self.state.step and self.state.optimizer:  # at a stage's start its optimizer is a new one
            optimizer.load_state_dict(self.state.optimizer)
        self.state.optimizer = None  # twice the weights' size, and read
        return _Stage(name, first, end, module, optimizer, cached, source.parts)

    def _step(self, stage: _Stage) -> None:
        """Learn from one batch; measure and save every so often."""
        state, recipe = self.state, self.recipe
        if recipe.sampler == "cliques" and state.step and state.step % recipe.mine_every == 0:
            self._mine()
        rate = learning_rate_factor(state.step - stage.first, stage.end - stage.first, recipe)
        set_learning_rates(stage.optimizer, rate)
        loss = self._learn(stage, self.batches.batch(state.step))
        update_average(state.average, state.model, decay=recipe.average, step=state.step)
        state.step += 1
        self.logger.draw(state, stage.optimizer, loss)
        measured = state.step % recipe.measure_every == 0 or state.step == stage.end
        if measured:
            for unreadable in self.batches.newly_unreadable():
                self.logger.say(unreadable)
            self.logger.measure(state, stage=stage.name, loss=loss)
        # Saved with each measurement, which may have found the best weights so far.
        if measured or state.step % recipe.save_every == 0:
            self.logger.save(state, stage.optimizer, self.fabric.strategy.precision.state_dict())
            self.fabric.barrier()

    def _learn(self, stage: _Stage, batch: Sequence[View]) -> float:
        """One step of the optimizer; the batch's loss."""
        # Seeded by the step's number, so that nothing random need be saved for a run to go on as it would have.
        seed = step_seed(self.recipe.seed, self.state.step, self.fabric.global_rank)
        torch.manual_seed(seed)
        stage.module.train()
        parts = stage.parts(self.state.step, batch)
        if stage.cached:  # again: whatever had to be described first must make no difference
            torch.manual_seed(seed)
        labels = self.batches.labels(batch)
        loss = float(
            backward_in_parts(
                self.fabric, stage.module, parts=parts, labels=labels, objective=self.objective, seed=seed
            )
        )
        length = self.fabric.clip_gradients(
            stage.module,
            stage.optimizer,
            max_norm=self.recipe.clip or math.inf,  # without a limit too: it is what tells the length
            error_if_nonfinite=False,  # half precision may overshoot, and is looked at below
        )
        if not math.isfinite(loss):
            raise self.logger.stop(self.state, batch, f"the loss is {loss}")
        # A scale above 1 may be what made the gradient infinite: the scaler leaves such a step out and lowers itself.
        scaler = getattr(self.fabric.strategy.precision, "scaler", None)
        scaled = scaler is not None and float(scaler.get_scale()) >= 1
        if not math.isfinite(float(length)) and not scaled:
            raise self.logger.stop(self.state, batch, f"the gradient's length is {float(length)}")
        stage.optimizer.step()
        stage.optimizer.zero_grad()
        return loss

    def _mine(self) -> None:
        """Look for places that look alike to the model as it stands, and draw batches from those."""
        cliques: list[list[int]] = []
        if self.logger.first:  # every process would find the same, and describe all places for it
            cliques = mine(
                Describer.of(self.state.average),
                self.batches.places,
                self.batches.images_in_use,
                folder=self.logger.folder,
                size=self.recipe.clique,
            )
            self.logger.say(f"{len(cliques)} cliques of places that look alike at step {self.state.step}")
        self.state.cliques = self.fabric.broadcast(cliques)
        self.batches.use_cliques(self.state.cliques)
