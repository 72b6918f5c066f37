"""Where a run stands: everything its next step depends on, and so what a checkpoint holds."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from salad.model.describer import Describer


class State:
    """The weights of a run, their running mean, the best so far, and how many steps were made.

    Nothing random is in it: every step is seeded by its number.

    Args:
        model: what is trained.
        tuned_share: how far the weights kept lie on the way from `before` to `average`.

    Attributes:
        model: the weights of the last step.
        average: their running mean.
        before: that mean as it was before the backbone was trained; None until then.
        best: the highest score so far, and the weights kept that reached it.
        step: steps made.
        cliques: numbers of places that looked alike when last looked at.
        momenta: the optimizer's memory as it was saved; None at a stage's start.
        scaler: the loss scale of half precision as it was saved.
    """

    def __init__(self, model: Describer, *, tuned_share: float = 1.0) -> None:
        self.model, self.average = model, copy.deepcopy(model)
        self.tuned_share = tuned_share
        self.before: dict[str, Tensor] | None = None
        self.best: dict[str, Any] = {"score": -1.0, "weights": self.average.state_dict()}
        self.step = 0
        self.cliques: list[list[int]] = []
        self.momenta: dict[str, Any] | None = None
        self.scaler: dict[str, Any] = {}
        self._before, self._began = 0.0, time.monotonic()

    @property
    def seconds(self) -> float:
        """How long the run has taken, interruptions left out."""
        return self._before + time.monotonic() - self._began

    def to(self, device: torch.device) -> None:
        """Move the weights to where they are trained."""
        self.model.to(device)
        self.average.to(device)

    def remember(self) -> None:
        """The backbone is about to be trained: keep the weights from before, if they are wanted later."""
        if self.tuned_share < 1:
            self.before = copy.deepcopy(self.average.state_dict())

    def kept(self) -> Describer:
        """The model as it would be kept if the run ended here: it is what is measured."""
        if self.before is None:
            return self.average
        kept = copy.deepcopy(self.average)
        for name, weight in kept.state_dict().items():
            if weight.is_floating_point():  # a batch norm counts its batches too
                weight.copy_(self.before[name].to(weight).lerp(weight, self.tuned_share))
        return kept

    def improved(self, score: float, kept: Describer) -> bool:
        """Take these weights for the best if none had so high a score; whether they are taken."""
        if score <= self.best["score"]:
            return False
        self.best = {"score": score, "weights": copy.deepcopy(kept.state_dict())}
        return True

    def as_saved(self, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> dict[str, Any]:
        """What `take_up` reads."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "before": self.before,
            "best": self.best,
            "cliques": self.cliques,
            "seconds": self.seconds,
            "optimizer": optimizer.state_dict(),
            "scaler": dict(scaler),
        }

    def take_up(self, saved: Mapping[str, Any]) -> None:
        """Stand where a run stood when it was saved."""
        self.model.load_state_dict(saved["model"])
        self.average.load_state_dict(saved["average"])
        self.best, self.step, self.momenta = saved["best"], saved["step"], saved["optimizer"]
        # what checkpoints of older versions do not hold
        self.before = saved.get("before")
        self.cliques, self.scaler = saved.get("cliques", []), saved.get("scaler", {})
        self._before, self._began = saved.get("seconds", 0.0), time.monotonic()
