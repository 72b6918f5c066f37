"""The notebooks in examples/ run from top to bottom, and carry no outputs with them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*.ipynb"))


def _read(path: Path) -> Any:
    nbformat = pytest.importorskip("nbformat", reason="notebooks are run by the extra `docs`")
    return nbformat.read(path, as_version=4)


def test_there_are_two() -> None:
    assert [path.name for path in NOTEBOOKS] == ["what_salad_sees.ipynb", "where_was_this_taken.ipynb"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_whole_small_and_cleared(path: Path) -> None:
    notebook = _read(path)
    assert path.stat().st_size < 20_000
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, town: Path, tmp_path: Path) -> None:
    notebook = _read(path)
    nbclient = pytest.importorskip("nbclient", reason="notebooks are run by the extra `docs`")
    pytest.importorskip("ipykernel", reason="notebooks are run by the extra `docs`")
    shutil.copytree(town, tmp_path / "demo")
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    told = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    warned = [output.text for output in told if output.get("name") == "stderr"]
    assert not warned
    shown = {kind for output in told for kind in output.get("data", ())}
    assert "image/png" in shown
    assert ("image/svg+xml" in shown) == (path.stem == "where_was_this_taken")  # the map
