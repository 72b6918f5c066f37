"""Curves for TensorBoard: there, of every step, and without those that a killed run had drawn too far."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from salad.errors import MissingExtraError
from salad.training.logger import BOARD, open_board

Teach = Callable[..., Path]


def _curves(run: Path) -> dict[str, list[int]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / BOARD))
    events.Reload()
    return {name: [point.step for point in events.Scalars(name)] for name in events.Tags()["scalars"]}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # tensorboard's own
def test_a_run_draws_loss_rate_and_score(teach: Teach, tmp_path: Path) -> None:
    teach(tmp_path, board=True)
    curves = _curves(tmp_path)
    assert curves["loss"] == curves["rate"] == [1, 2, 3, 4]
    assert curves["score/mean"] == [1, 2, 3, 4]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_was_drawn_too_far_is_wiped(tmp_path: Path) -> None:
    killed = open_board(tmp_path, step=0)
    for step in (1, 2, 3):
        killed.add_scalar("loss", 1.0, step)
    killed.flush()
    resumed = open_board(tmp_path, step=2)
    resumed.add_scalar("loss", 2.0, 3)
    resumed.close()
    killed.close()
    assert _curves(tmp_path)["loss"] == [1, 2, 3]


def test_without_tensorboard_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingExtraError, match="curves for TensorBoard needs the 'train' extra"):
        open_board(tmp_path, step=0)
