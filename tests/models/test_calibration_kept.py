"""A calibration travels with its model, and leaves descriptors and fingerprint alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from salad.errors import WeightsError
from salad.localize.locate import calibration_of
from salad.localize.voting import GENERIC
from salad.models.describer import Describer
from salad.models.model_folder import CONFIG, WEIGHTS, read_folder, write_calibration, write_folder
from salad.network.aggregator_config import SaladConfig
from salad.network.config import Calibration, LiteConfig, ModelConfig, Preprocessing
from salad.network.network import build

MINE = Calibration(sharpness=30.0, bias=-3.25, radius=0.5, min_confidence=0.625, provenance="drawn")


@pytest.fixture(scope="module")
def model() -> Describer:
    aggregator = SaladConfig(width=24, clusters=4, cluster_dim=8, scene_dim=8, hidden=16)
    return Describer.of(build(ModelConfig("tiny", LiteConfig(blocks=3), aggregator, Preprocessing(64, 64))))


def test_it_is_written_beside_the_weights_and_read_back(model: Describer, tmp_path: Path) -> None:
    folder = write_folder(model, tmp_path / "m")
    weights = (folder / WEIGHTS).read_bytes()
    assert read_folder(folder).calibration is None
    for calibration in (MINE, replace(MINE, top=1.0)):
        write_calibration(folder, calibration)
        again = read_folder(folder)
        assert again.calibration == calibration
        assert again.config == replace(model.config, calibration=calibration)
        assert again.fingerprint == model.fingerprint
    assert (folder / WEIGHTS).read_bytes() == weights
    assert sorted(path.name for path in folder.iterdir()) == sorted([CONFIG, WEIGHTS])


def test_a_copy_of_a_calibrated_model_is_calibrated(model: Describer, tmp_path: Path) -> None:
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)
    assert read_folder(write_folder(read_folder(folder), tmp_path / "copy")).calibration == MINE


def test_places_are_judged_by_the_models_own_else_by_a_generic_one(model: Describer, tmp_path: Path) -> None:
    assert calibration_of(model) is GENERIC
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)
    assert calibration_of(read_folder(folder)) == MINE


def test_what_is_no_model_takes_none(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="holds no config"):
        write_calibration(tmp_path, MINE)
    assert list(tmp_path.iterdir()) == []


def test_on_a_full_disk_the_old_one_stays(
    model: Describer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_folder(model, tmp_path / "m")
    write_calibration(folder, MINE)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(WeightsError, match="No space left"):
        write_calibration(folder, GENERIC)
    monkeypatch.undo()
    assert read_folder(folder).calibration == MINE
    assert sorted(path.name for path in folder.iterdir()) == sorted([CONFIG, WEIGHTS])
