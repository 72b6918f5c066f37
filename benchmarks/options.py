"""What all benchmarks take: options that their docstring tells of, models, and where the photos lie."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RUNS = ROOT / "runs"  # what trains writes here; git does not look into it
DATA = ROOT.parent / "shared" / "data"
"""The shared photos, which are no part of the repository: beside the checkout, or where `--data` says."""
TRAIN, EVAL = DATA / "train", DATA / "eval"
SHIPPED = ("salad-lite", "salad-lite-route", "salad-vits")


def benchmark_parser(
    told: str | None, *, models: Sequence[str] = (), data: Path | None = None
) -> argparse.ArgumentParser:
    """Options to add to.

    Args:
        told: The benchmark's docstring, which is what `--help` says of it.
        models: Measured where no MODEL is named; without any, none is asked for.
        data: Where photos lie if `--data` does not say so; without it, none are asked for.
    """
    made = argparse.ArgumentParser(description=told, formatter_class=argparse.RawDescriptionHelpFormatter)
    if models:
        shown = f"of the zoo, a folder or a published file; by default {', '.join(models)}"
        made.add_argument("models", nargs="*", default=list(models), metavar="MODEL", help=shown)
    if data is not None:
        made.add_argument("--data", type=Path, default=data, metavar="DIR", help="default: %(default)s")
    return made
