"""What a run measures, as curves that TensorBoard draws: `tensorboard --logdir RUN`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from salad.errors import MissingExtraError

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
