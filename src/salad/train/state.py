"""Where a run stands: everything its next step depends on, and so what a checkpoint holds."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from typing import Any

import torch

from salad.model.describer import Describer


class State:
    """The weights of a run, their running mean, the best so far, and how many steps were made.

    Nothing random is in it: every step is seeded by its number.

    Args:
        model: what is trained.

    Attributes:
        model: the weights of the last step.
        average: their running mean, which is what is measured and kept.
        best: the highest score so far, and the mean weights that reached it.
        step: steps made.
        cliques: numbers of places that looked alike when last looked at.
        momenta: the optimizer's memory as it was saved; None at a stage's start.
        scaler: the loss scale of half precision as it was saved.
    """

    def __init__(self, model: Describer) -> None:
        self.model, self.average = model, copy.deepcopy(model)
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

    def improved(self, score: float) -> bool:
        """Keep the mean weights if none had so high a score; whether they are kept."""
        if score <= self.best["score"]:
            return False
        self.best = {"score": score, "weights": copy.deepcopy(self.average.state_dict())}
        return True

    def as_saved(self, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> dict[str, Any]:
        """What `take_up` reads."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
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
        self.cliques, self.scaler = saved.get("cliques", []), saved.get("scaler", {})
        self._before, self._began = saved.get("seconds", 0.0), time.monotonic()
