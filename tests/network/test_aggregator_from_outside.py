"""One aggregator more: the one that docs/extending.md shows, from outside, in one file."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import salad
from salad.errors import ModelError
from salad.network.aggregator_config import AGGREGATOR_KINDS, SaladConfig, compared_aggregators, register_aggregator
from salad.network.baseline_config import GemConfig
from salad.network.config import ModelConfig
from salad.network.network import build

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
KIND = "mean-max"


def shown_file() -> str:
    """The page's example, as whoever reads it would save it."""
    found = re.search(r'^```python title="mean_max\.py"\n(.*?)^```$', PAGE.read_text("utf-8"), re.M | re.S)
    assert found is not None
    return found[1]


@pytest.fixture
def mean_max(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The example, imported and registered; nothing of it is left behind."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "mean_max.py").write_text(shown_file(), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    yield import_module("mean_max")
    del sys.modules["mean_max"], AGGREGATOR_KINDS[KIND]


def test_the_example_is_short() -> None:
    assert shown_file().count("\n") < 60


def test_it_is_trained_for_ten_steps_kept_and_read_back(
    mean_max: ModuleType, teach: Any, lite: ModelConfig, tmp_path: Path
) -> None:
    config = dataclasses.replace(lite, aggregator=mean_max.MeanMaxConfig(16, channels=8))
    folder = teach(tmp_path / "run", model=config, recipe={"head_steps": 5, "tune_steps": 5})
    steps = [json.loads(line)["step"] for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert steps[-1] == 10
    model = salad.load(folder)
    assert model.config == config
    untrained, trained = build(config).state_dict(), model.network.state_dict()
    assert not np.allclose(trained["aggregator.narrow.weight"], untrained["aggregator.narrow.weight"], atol=1e-4)
    rows = model.describe([np.full((32, 32, 3), level, np.uint8) for level in (0, 200)])
    assert rows.shape == (2, 16)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-6)
    with pytest.raises(ModelError, match="tiny has no dustbin to show: its aggregator is not SALAD"):
        model.token_assignment(np.zeros((32, 32, 3), np.uint8))


def test_it_is_compared_and_written_like_any_other(mean_max: ModuleType) -> None:
    compared = compared_aggregators(112)
    assert compared[KIND] == mean_max.MeanMaxConfig(112)
    assert compared["salad"].kind == "salad"
    with pytest.raises(ModelError, match="channels of the mean-max aggregator is 0"):
        mean_max.MeanMaxConfig(112, channels=0)


def test_no_two_aggregators_have_one_kind(mean_max: ModuleType) -> None:
    register_aggregator(mean_max.MeanMaxConfig)  # the same again does no harm

    @dataclasses.dataclass(frozen=True, slots=True)
    class Other(GemConfig):
        kind: str = "salad"

    with pytest.raises(ModelError, match="of kind 'salad' already: give Other another kind"):
        register_aggregator(Other)
    assert AGGREGATOR_KINDS["salad"] is SaladConfig


def test_an_installed_package_is_found_by_its_entry_point(
    mean_max: ModuleType, teach: Any, lite: ModelConfig, tmp_path: Path
) -> None:
    """In a process that imports nothing of it: what `pip install` leaves is enough."""
    from salad.models.model_folder import write_folder

    site, config = tmp_path / "site", dataclasses.replace(lite, aggregator=mean_max.MeanMaxConfig(16))
    folder = write_folder(build(config), tmp_path / "model")
    code = "import salad, sys; sys.path.insert(0, sys.argv[2]); print(salad.load(sys.argv[1]).fingerprint)"

    def load() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code, str(folder), str(site)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert "kind 'mean-max' is unknown; known are salad, netvlad" in load().stderr
    (site / "theirs-1.dist-info").mkdir()
    (site / "theirs-1.dist-info" / "METADATA").write_text("Name: theirs\nVersion: 1\n", encoding="utf-8")
    points = site / "theirs-1.dist-info" / "entry_points.txt"
    points.write_text("[salad.aggregators]\nmean-max = mean_max:MeanMaxConfig\n", encoding="utf-8")
    assert load().stdout.strip() == build(config).fingerprint
    points.write_text("[salad.aggregators]\nmean-max = gone:MeanMaxConfig\n", encoding="utf-8")
    assert "'mean-max' is gone:MeanMaxConfig, which cannot be imported: No module named 'gone'" in load().stderr
