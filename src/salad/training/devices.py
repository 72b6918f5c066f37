"""Where a run takes place: one process, or one for each device of each machine."""

from __future__ import annotations

import platform
from contextlib import suppress
from importlib import metadata
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from salad._version import __version__
from salad.errors import ModelError, needs_extra
from salad.training.recipe import Precision

_PACKAGES = ("lightning-fabric", "pytorch-metric-learning", "kornia", "numpy")  # that bear on the weights


def launch_fabric(accelerator: str, precision: Precision, *, devices: int = 1, nodes: int = 1) -> Any:
    """A Fabric whose processes run: this one, and with several devices one more for each of the others.

    The others are this very command started again, so they come to this line by themselves.

    Args:
        accelerator: Fabric's word for where to run: `auto`, `cpu`, `gpu`, `mps`.
        precision: Fabric's word for how numbers are held.
        devices: devices of this machine; on `cpu`, processes.
        nodes: machines, on each of which the command was started.

    Raises:
        MissingExtraError: If the `train` extra is not installed.
        ModelError: If there is no such accelerator here, or not so many devices.
    """
    with needs_extra("training", "train"):
        from lightning_fabric import Fabric
        from lightning_fabric.strategies.ddp import DDPStrategy
    many = devices * nodes > 1
    try:
        # Buffers are alike in every process from the start; sending them along at each part would only tie
        # processes together that may have one part more or less.
        strategy = DDPStrategy(broadcast_buffers=False) if many else "auto"
        fabric = Fabric(
            accelerator=accelerator, devices=devices, num_nodes=nodes, precision=precision, strategy=strategy
        )
        if many:
            fabric.launch()
    except Exception as error:  # Fabric's, torch's and each device's own kinds
        said = str(error).strip().splitlines() or [type(error).__name__]
        raise ModelError(
            f"training cannot run on {devices} of {accelerator!r} on {nodes} machine(s): {said[0]}"
        ) from error
    return fabric


def precision_here(wanted: Precision, accelerator: str) -> Precision:
    """How numbers are best held where a run takes place: as wanted, but not in bf16 on a processor without it.

    There torch computes bfloat16 all the same, one number after the other, and a step takes minutes.

    Args:
        wanted: what the recipe says.
        accelerator: Fabric's word for where to run.
    """
    card = torch.accelerator.is_available()
    on_processor = accelerator == "cpu" or (accelerator == "auto" and not card)
    return "32-true" if wanted == "bf16-mixed" and on_processor and not _has_bfloat16() else wanted


def _has_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16, as far as torch tells."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return hasattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported") and bool(
            torch.ops.mkldnn._is_mkldnn_bf16_supported()
        )
    # The same question answers yes for every x86 with AVX-512, which most of them only imitate. An older torch does not
    # know the two that follow, and then it is as it always was.
    asked = [getattr(torch.cpu, f"_is_{name}_supported", None) for name in ("avx512_bf16", "amx_tile")]
    return any(ask is None or ask() for ask in asked)


def rank() -> int:
    """Which of all processes this one is, from 0 on, as far as Fabric has started any."""
    try:
        from lightning_fabric.utilities.rank_zero import rank_zero_only
    except ImportError:  # nobody can have started another
        return 0
    return int(getattr(rank_zero_only, "rank", 0))


def first_process() -> bool:
    """Whether this process is the one that speaks and writes."""
    return rank() == 0


def rank_slice(total: int, rank: int, ranks: int) -> slice:
    """Which of `total` things one of several processes takes: none twice, and no process two more than another."""
    return slice(total * rank // ranks, total * (rank + 1) // ranks)


def gather_slices(fabric: Any, mine: Float[Tensor, "mine dim"], total: int) -> Float[Tensor, "total dim"]:
    """Every process's rows in the order of the whole, of which this one has its `rank_slice`."""
    ranks = fabric.world_size
    if ranks == 1:
        return mine
    # Slices may differ by one, and what is gathered must be of one length: filled up here, cut off again below.
    longest = -(-total // ranks)
    rows = fabric.all_gather(F.pad(mine, (0, 0, 0, longest - len(mine))))
    slices = [rank_slice(total, rank, ranks) for rank in range(ranks)]
    return torch.cat([each[: own.stop - own.start] for each, own in zip(rows, slices, strict=True)])


def step_seed(seed: int, step: int, rank: int = 0) -> int:
    """What seeds everything random of one step in one process; the ranks of a step differ from each other."""
    # The first process keeps the plain sum that runs on one device always had, so that they go on as they began.
    return seed * 1_000_003 + step if rank == 0 else combined_seed(seed, step, rank)


def combined_seed(*numbers: int) -> int:
    """One seed from several numbers, unlike that of any others."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])


def versions() -> dict[str, str]:
    """What a run is made with, for whoever wants to repeat it."""
    made_with = {"salad": __version__, "torch": torch.__version__}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            made_with[package] = metadata.version(package)
    return made_with
