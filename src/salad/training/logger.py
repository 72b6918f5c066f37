"""What a run tells and keeps as it goes: measurements, curves, checkpoints, and the models in the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from salad.datasets.training_place import View
from salad.errors import TrainingError, needs_extra
from salad.models.describer import Describer
from salad.models.model_folder import write_folder
from salad.training import checkpoint
from salad.training.checkpoint import TrainingState
from salad.training.validation import Judge

Say = Callable[[str], None]
BOARD = "board"
_PHOTOS_NAMED = 4  # of a batch that an error is about; all of them stand in a file


class RunLogger:
    """The only one that writes into a run's folder, in the first process alone.

    Args:
        folder: the run's.
        identity: what makes the run this one, for whoever wants to go on with it.
        judge: what measures the model; None where the last weights are as good as any.
        say: takes a line whenever there is something to tell; in the first process alone.
        first: whether this is the first process; in all others nothing happens here.
        processes: how many share the batches.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        *,
        judge: Judge | None,
        say: Say,
        first: bool,
        processes: int = 1,
    ) -> None:
        self.folder, self.identity, self.judge = folder, identity, judge
        self.first, self.processes = first, processes
        self.say: Say = say if first else lambda _: None
        self._board: Any = None  # TensorBoard's writer: torch gives it no types

    def begin(
        self, state: TrainingState, saved: Mapping[str, Any] | None, *, config: Mapping[str, Any], board: bool
    ) -> None:
        """Open the folder: for a new run, or at the step where the one that was saved goes on."""
        if not self.first:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        if saved is None or not (self.folder / checkpoint.CONFIG).is_file():
            checkpoint.write_json(self.folder / checkpoint.CONFIG, config)
        checkpoint.trim_log(self.folder, state.step)
        if saved is not None:
            self.say(f"going on from step {state.step}")
            before = saved.get("processes", self.processes)
            if before != self.processes:  # each process draws from a chance of its own
                self.say(
                    f"the run began on {before} processes and goes on on {self.processes}: what is random falls "
                    "out differently from here"
                )
        if board:
            self._board = open_board(self.folder, step=state.step)

    def draw(self, state: TrainingState, optimizer: torch.optim.Optimizer, loss: float) -> None:
        """Add a step's loss and rate to the curves."""
        if self._board:
            self._board.add_scalar("loss", loss, state.step)
            self._board.add_scalar("rate", max(group["lr"] for group in optimizer.param_groups), state.step)

    def measure(self, state: TrainingState, *, stage: str, loss: float) -> None:
        """Judge the weights that would be kept, take them if they are the best, and tell.

        Raises:
            TrainingError: If the judge's mean is no number.
        """
        if not self.first:
            return
        measurement: dict[str, Any] = {
            "step": state.step,
            "stage": stage,
            "loss": round(loss, 4),
            "seconds": round(state.seconds, 1),
        }
        kept = state.kept()
        score = float(state.step)  # nothing to choose by: the last
        if self.judge:
            figures = self.judge(Describer.of(kept))
            score = figures.get("mean", math.nan)
            if not math.isfinite(score):
                raise TrainingError(
                    f"the judge gave no mean that is a number at step {state.step}, but {dict(figures)}"
                )
            measurement[self.identity["judge"]] = figures
            if self._board:
                for name, value in figures.items():
                    self._board.add_scalar(f"score/{name}", value, state.step)
                self._board.flush()
        state.remember_best(score, kept)
        self.say(checkpoint.append_to_log(self.folder, measurement))

    def save(self, state: TrainingState, optimizer: torch.optim.Optimizer, scaler: Mapping[str, Any]) -> None:
        """Write the checkpoint that a killed run goes on from."""
        if self.first:
            run = {**self.identity, "processes": self.processes}
            checkpoint.save_checkpoint(self.folder, {**run, **state.state_dict(optimizer, scaler)})

    def stop(self, state: TrainingState, batch: Sequence[View], what: str) -> TrainingError:
        """Name the batch that a run cannot get past: a few photos in the sentence, all of them in a file."""
        photos, path = [str(view.path) for view in batch], self.folder / checkpoint.STOPPED
        if self.first:
            checkpoint.write_json(path, {"step": state.step, "why": what, "photos": photos})
        return TrainingError(
            f"{what} at step {state.step + 1}, in the batch of {', '.join(photos[:_PHOTOS_NAMED])}"
            f"{f' and {len(photos) - _PHOTOS_NAMED} more' if len(photos) > _PHOTOS_NAMED else ''} "
            f"(all in {path}); the checkpoint before it stays. Look at these photos, or "
            "begin anew with lower rates or precision 32-true"
        )

    def end(self, state: TrainingState) -> Path:
        """Write the best weights and the last ones as models; the folder of the best."""
        if self._board:
            self._board.close()
        best = self.folder / checkpoint.MODEL
        if self.first:
            last = state.kept().cpu().eval()
            write_folder(last, self.folder / checkpoint.LAST, dtype="float16", overwrite=True)
            model = state.model.cpu().eval()
            model.load_state_dict(state.best["weights"])
            # The best is written last: where it stands, the run has ended.
            write_folder(model, best, dtype="float16", overwrite=True)
        return best


def open_board(folder: Path, *, step: int) -> Any:
    """Curves in the folder `board` of a run, as TensorBoard draws them: `tensorboard --logdir RUN`.

    Args:
        folder: the run's.
        step: where it goes on; what a killed run drew beyond that is wiped.

    Raises:
        MissingExtraError: If tensorboard is not installed.
    """
    with needs_extra("drawing curves for TensorBoard", "train"):
        from torch.utils.tensorboard import SummaryWriter
    writer: Any = SummaryWriter
    return writer(str(folder / BOARD), purge_step=step + 1)
