"""What every test may lean on."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("shared machine", deadline=None)  # a busy machine is no bug
settings.load_profile("shared machine")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with golden tensors and real photos beside the checkout; skips where there is none."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not (folder / "golden").is_dir():
        pytest.skip(f"no golden tensors or photos at {folder}: they are not part of the repository")
    return folder
