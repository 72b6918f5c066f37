"""What every test may lean on, and which tests can run here: those that need torch are skipped where there is none."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Generator, Sequence
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("here", deadline=None)  # a busy machine is no bug
settings.register_profile("ci", deadline=None, derandomize=True)  # a verdict on the change, not on the day's luck
settings.load_profile("ci" if os.environ.get("CI") else "here")

WHY = "torch is not installed: pip install 'salad-vpr[train]'"


def _has_torch() -> bool:
    try:
        return importlib.util.find_spec("torch") is not None  # looked for, not loaded: that takes a second
    except ModuleNotFoundError:  # tests/without_torch hides it
        return False


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Skip a file that imports torch itself; `test_without_torch.py` holds that little of the package does."""
    report = yield
    if report.failed and not _has_torch() and re.search("No module named '(torch|onnx)", str(report.longrepr)):
        report.outcome, report.longrepr = "skipped", (str(report.nodeid), 0, f"Skipped: {WHY}")
    return report


def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    """Skip single tests marked `torch`."""
    if not _has_torch():
        for item in items:
            if item.get_closest_marker("torch"):
                item.add_marker(pytest.mark.skip(reason=WHY))


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photos are read in this process, as where no other can be started: so what a test patches is what reads them."""
    from salad.images import workers

    monkeypatch.setattr(workers, "SHARED", workers.Pool("raise SystemExit"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with golden tensors and real photos beside the checkout; skips where there is none."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not (folder / "golden").is_dir():
        pytest.skip(f"no golden tensors or photos at {folder}: they are not part of the repository")
    return folder


@pytest.fixture(scope="session")
def cases() -> Path:
    """The folder with photos, tables and files as people have them, beside the checkout; skips where there is none."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "cases"
    if not folder.is_dir():
        pytest.skip(f"no cases at {folder}: they are not part of the repository")
    return folder
