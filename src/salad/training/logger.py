"""What a run tells and keeps as it goes: measurements, curves, checkpoints, and the models in the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from salad.datasets.training_place import View
from salad.errors import MissingExtraError, TrainingError
from salad.models.model_folder import write_folder
from salad.training import checkpoint
from salad.training.checkpoint import State
from salad.training.validation import Judge

# --- What a run measures, as curves that TensorBoard draws: `tensorboard --logdir RUN` ---


BOARD = "board"


class Board:
    """Curves in the folder `board` of a run.

    Args:
        folder: the run's.
        step: where it goes on; what a killed run drew beyond that is wiped.

    Raises:
        MissingExtraError: tensorboard is not installed.
    """

    def __init__(self, folder: Path, *, step: int) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise MissingExtraError("drawing curves for TensorBoard", "train") from error
        writer: Any = SummaryWriter
        self._writer = writer(str(folder / BOARD), purge_step=step + 1)

    def draw(self, step: int, values: Mapping[str, float]) -> None:
        """Add a point to each curve named."""
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def flush(self) -> None:
        """Let whoever watches see what was drawn."""
        self._writer.flush()

    def close(self) -> None:
        """Write the rest."""
        self._writer.close()


Say = Callable[[str], None]
_NAMED = 4  # photos of a batch that an error names; all of them stand in a file


class Record:
    """The one hand that writes into a run's folder, in the first process alone.

    Args:
        folder: the run's.
        identity: what makes the run this one, for whoever wants to go on with it.
        judge: what measures the model; None where the last weights are as good as any.
        tell: takes a line whenever there is something to tell.
        first: whether this is the first process; in all others nothing happens here.
        processes: how many share the batches.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        *,
        judge: Judge | None,
        tell: Say,
        first: bool,
        processes: int = 1,
    ) -> None:
        self.folder, self.identity, self.judge = folder, identity, judge
        self.tell, self.first, self.processes = tell, first, processes
        self._board: Board | None = None

    def begin(
        self, state: State, saved: Mapping[str, Any] | None, *, resolved: Mapping[str, Any], board: bool
    ) -> None:
        """Open the folder: for a new run, or at the step where the one that was saved goes on."""
        if not self.first:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        if saved is None or not (self.folder / checkpoint.CONFIG).is_file():
            checkpoint.write_json(self.folder / checkpoint.CONFIG, resolved)
        checkpoint.trim_log(self.folder, state.step)
        if saved is not None:
            self.tell(f"going on from step {state.step}")
            before = saved.get("processes", self.processes)
            if before != self.processes:
                self.tell(
                    f"the run began on {before} processes and goes on on {self.processes}: what is random falls "
                    "out differently from here"
                )
        if board:
            self._board = Board(self.folder, step=state.step)

    def draw(self, state: State, optimizer: torch.optim.Optimizer, loss: float) -> None:
        """Add a step's loss and rate to the curves."""
        if self._board:
            rate = max(group["lr"] for group in optimizer.param_groups)
            self._board.draw(state.step, {"loss": loss, "rate": rate})

    def measure(self, state: State, *, stage: str, loss: float) -> None:
        """Judge the weights that would be kept, take them if they are the best, and tell."""
        if not self.first:
            return
        told: dict[str, Any] = {
            "step": state.step,
            "stage": stage,
            "loss": round(loss, 4),
            "seconds": round(state.seconds, 1),
        }
        kept = state.kept()
        score = float(state.step)  # nothing to choose by: the last
        if self.judge:
            told[self.identity["judge"]] = figures = self.judge(kept)
            score = self._score(figures, state.step)
            if self._board:
                self._board.draw(state.step, {f"score/{name}": value for name, value in figures.items()})
                self._board.flush()
        state.improved(score, kept)
        self.tell(checkpoint.write_log(self.folder, told))

    def _score(self, figures: Mapping[str, float], step: int) -> float:
        score = figures.get("mean", math.nan)
        if not math.isfinite(score):
            raise TrainingError(
                f"the judge gave no mean that is a number at step {step}, but {dict(figures)}"
            )
        return score

    def save(self, state: State, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> None:
        """Write the checkpoint that a killed run goes on from."""
        if self.first:
            told = {**self.identity, "processes": self.processes}
            checkpoint.save(self.folder, {**told, **state.as_saved(optimizer, scaler)})

    def stop(self, state: State, batch: Sequence[View], what: str) -> TrainingError:
        """Name the batch that a run cannot get past: a few photos in the sentence, all of them in a file."""
        photos = [str(view.path) for view in batch]
        if self.first:
            checkpoint.write_json(
                self.folder / checkpoint.STOPPED, {"step": state.step, "why": what, "photos": photos}
            )
        return TrainingError(
            f"{what} at step {state.step + 1}, in the batch of {', '.join(photos[:_NAMED])}"
            f"{f' and {len(photos) - _NAMED} more' if len(photos) > _NAMED else ''} "
            f"(all in {self.folder / checkpoint.STOPPED}); the checkpoint before it stays. Look at these photos, or "
            "begin anew with lower rates or precision 32-true"
        )

    def end(self, state: State) -> Path:
        """Write the best weights and the last ones as models; the folder of the best."""
        if self._board:
            self._board.close()
        best = self.folder / checkpoint.MODEL
        if self.first:
            last = state.kept().cpu().eval()
            write_folder(last, self.folder / checkpoint.LAST, dtype=torch.float16, overwrite=True)
            model = state.model.cpu().eval()
            model.load_state_dict(state.best["weights"])
            write_folder(model, best, dtype=torch.float16, overwrite=True)
        return best
