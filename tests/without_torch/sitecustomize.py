"""With this folder on PYTHONPATH no Python that starts can import torch, nor what leans on it, wherever they are.

    PYTHONPATH=tests/without_torch pytest tests/cli

Workers and commands that tests start inherit it, where an import hook set by a test would not reach. Packages that only
torch brings along are still found: `scripts/test-long` looks for those, in an environment that has no torch.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from typing import Any

ABSENT = {"torch", "kornia", "lightning_fabric", "onnx", "onnxscript", "pytorch_metric_learning", "transformers"}


class Absent:
    """Finds nothing, and lets nobody else look."""

    @staticmethod
    def find_spec(name: str, *_: Any) -> None:
        if name.partition(".")[0] in ABSENT:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


finder: Any = Absent
sys.meta_path.insert(0, finder)
_find_spec = importlib.util.find_spec


def find_spec(name: str, package: str | None = None) -> ModuleSpec | None:
    """Whether there is a module, asked by libraries that go without: no, and not an error as the import is."""
    return None if name.partition(".")[0] in ABSENT else _find_spec(name, package)


importlib.util.find_spec = find_spec
