"""A comparison with a trainer and measures that are fakes: what is run, what is not run again, what is kept."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from salad.ablation.grid_setup import GridSetup
from salad.ablation.grids import GridRow
from salad.ablation.run_result import RESULT_FILE, RunResult, read_result
from salad.ablation.runner import GridBenchmark, GridRunner, data_summary, milliseconds_a_photo
from salad.datasets.places import find_places
from salad.datasets.training_place import TrainingPlace
from salad.errors import ModelError, SaladError
from salad.models.describer import Describer
from salad.models.model_folder import load, write_folder
from salad.network.config import LiteConfig, Preprocessing
from salad.network.network import build
from salad.training.recipe import Preset, Recipe

SETUP = GridSetup(
    LiteConfig(blocks=2),
    4,
    Preprocessing(32, 32),
    "",
    Recipe(head_steps=1, tune_steps=3, places=2, views=2, held_out=0.34, precision="32-true"),
)
GEM = GridRow("gem", "GeM", "gem", blocks=1)
CONV = GridRow("conv-ap", "Conv-AP", "conv-ap", blocks=0)
VLAD = GridRow("vlad", "VLAD", "vlad", blocks=0, fitted=True)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> list[TrainingPlace]:
    root, chance = tmp_path_factory.mktemp("places") / "set", np.random.default_rng(0)
    for name in "abcdef":
        (root / name).mkdir(parents=True)
        for number in range(4):
            pixels = chance.integers(0, 256, (32, 32, 3), dtype=np.uint8)
            Image.fromarray(pixels).save(root / name / f"{number}.png")
    return find_places(root)


class Teacher:
    """Trains nothing: writes a model as a run would, and remembers what it was asked for."""

    def __init__(self, *, fails_at: str = "") -> None:
        self.fails_at = fails_at
        self.taught: list[tuple[str, int]] = []

    def __call__(
        self,
        preset: Preset,
        places: list[TrainingPlace],
        *,
        to: Path,
        accelerator: str,
        tokens: Path,
        progress: Callable[[int, int | None], None],
        say: Callable[[str], None],
    ) -> Path:
        to.mkdir(parents=True, exist_ok=True)
        (to / "last.ckpt").write_bytes(b"on the way")
        (to / "log.jsonl").write_text('{"step": 2, "seconds": 1.5}\n{"step": 4, "seconds": 7.5}\n')
        if preset.model.name == self.fails_at:
            raise KeyboardInterrupt
        self.taught.append((preset.model.name, preset.recipe.seed))
        progress(4, 4)
        return write_folder(build(preset.model, seed=preset.recipe.seed), to / "model", overwrite=True)


class Judged:
    """Measures nothing: a figure that the model's weights alone decide."""

    def __init__(self, protocol: str = "frames ±1") -> None:
        self.protocol, self.asked = protocol, 0

    def __call__(self, model: Describer) -> dict[str, Any]:
        self.asked += 1
        return {"protocol": self.protocol, "recall": {"1": int(model.fingerprint[:2], 16) / 2.56}}


def compared(places: list[TrainingPlace], to: Path, **change: Any) -> GridRunner:
    said: list[str] = []
    options: dict[str, Any] = {
        "setup": SETUP,
        "benchmarks": {"town": GridBenchmark("frames ±1", Judged())},
        "train_model": Teacher(),
        "say": said.append,
    } | change
    return GridRunner(places, to, **options)


def result_of(to: Path, row: str, seed: int) -> RunResult:
    found = read_result(to / row / f"seed{seed}")
    assert found is not None
    return found


def test_every_row_is_trained_with_every_seed_and_measured(places: list[TrainingPlace], tmp_path: Path) -> None:
    teacher, judged = Teacher(), Judged()
    bars: list[str] = []

    @contextmanager
    def progress_bar(doing: str) -> Iterator[Callable[[int, int | None], None]]:
        bars.append(doing)
        yield lambda done, total: None

    made = compared(
        places,
        tmp_path,
        train_model=teacher,
        benchmarks={"town": GridBenchmark("frames ±1", judged)},
        progress_bar=progress_bar,
    ).run([GEM, CONV], seeds=[0, 1])
    assert teacher.taught == [("gem", 0), ("conv-ap", 0), ("gem", 1), ("conv-ap", 1)]
    assert bars[0] == "gem, seed 0"
    assert judged.asked == 4
    assert {row: [one.seed for one in some] for row, some in made.items()} == {
        "gem": [0, 1],
        "conv-ap": [0, 1],
    }
    for row in ("gem", "conv-ap"):
        for seed in (0, 1):
            assert result_of(tmp_path, row, seed) in made[row]
            assert not (tmp_path / row / f"seed{seed}" / "last.ckpt").exists()


def test_an_outcome_holds_what_it_takes_to_repeat_it(places: list[TrainingPlace], tmp_path: Path) -> None:
    (found,) = compared(places, tmp_path).run([CONV], seeds=[1])["conv-ap"]
    model = load(tmp_path / "conv-ap" / "seed1" / "model")
    assert (found.dim, found.fingerprint, found.seed) == (model.dim, model.fingerprint, 1)
    assert found.preset["model"] == json.loads(json.dumps(model.config.as_dict()))
    assert (found.preset["recipe"]["seed"], found.preset["recipe"]["tune_steps"]) == (1, 3)
    head = sum(weight.numel() for weight in model.network.aggregator.parameters())
    assert found.parameters == {"all": sum(w.numel() for w in model.network.parameters()), "trained": head}
    assert found.data["places"], found.data["photos"] == (6, 24)
    assert set(found.held_out) == {"set", "mean"}
    assert {"python", "salad", "torch"} <= set(found.versions)
    assert found.machine["device"] == "cpu"
    assert found.milliseconds > 0
    assert found.seconds["training"] == 7.5  # as the run's log says
    assert found.benchmarks["town"]["recall"]["1"] == Judged()(model)["recall"]["1"]


def test_trained_blocks_count_as_trained(places: list[TrainingPlace], tmp_path: Path) -> None:
    made = compared(places, tmp_path).run([GEM, replace(GEM, name="all", blocks=2)], seeds=[0])
    one, whole = made["gem"][0].parameters, made["all"][0].parameters
    assert 1 < one["trained"] < one["all"]
    assert whole["trained"] == whole["all"] == one["all"]


def test_a_finished_run_is_never_repeated(places: list[TrainingPlace], tmp_path: Path) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    before = (tmp_path / "gem" / "seed0" / RESULT_FILE).read_bytes()
    teacher, judged = Teacher(), Judged()
    again = compared(places, tmp_path, train_model=teacher, benchmarks={"town": GridBenchmark("frames ±1", judged)})
    again.run([GEM, CONV], seeds=[0])
    assert teacher.taught == [("conv-ap", 0)]
    assert judged.asked == 1
    assert (tmp_path / "gem" / "seed0" / RESULT_FILE).read_bytes() == before


def test_an_interrupt_leaves_what_was_finished(places: list[TrainingPlace], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        compared(places, tmp_path, train_model=Teacher(fails_at="conv-ap")).run([GEM, CONV], seeds=[0, 1])
    assert result_of(tmp_path, "gem", 0).row == "gem"
    assert (tmp_path / "conv-ap" / "seed0" / "last.ckpt").is_file()  # from where it goes on
    teacher = Teacher()
    compared(places, tmp_path, train_model=teacher).run([GEM, CONV], seeds=[0, 1])
    assert teacher.taught == [("conv-ap", 0), ("gem", 1), ("conv-ap", 1)]


def test_a_new_set_is_measured_with_the_model_there_is(places: list[TrainingPlace], tmp_path: Path) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    first, second, teacher = Judged(), Judged("radius 25 m"), Teacher()
    sets = {"town": GridBenchmark("frames ±1", first), "street": GridBenchmark("radius 25 m", second)}
    compared(places, tmp_path, train_model=teacher, benchmarks=sets).run([GEM], seeds=[0])
    assert (teacher.taught, first.asked, second.asked) == ([], 0, 1)
    found = result_of(tmp_path, "gem", 0)
    assert list(found.benchmarks) == ["town", "street"]
    assert found.benchmarks["town"]["recall"]["1"] == found.benchmarks["street"]["recall"]["1"]  # the same model


def test_a_set_of_that_name_by_another_protocol_is_refused(places: list[TrainingPlace], tmp_path: Path) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    other = {"town": GridBenchmark("frames ±2", Judged("frames ±2"))}
    with pytest.raises(ModelError, match="by the protocol 'frames ±1', not 'frames ±2'"):
        compared(places, tmp_path, benchmarks=other).run([GEM], seeds=[0])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"recipe": replace(SETUP.recipe, tune_steps=4)}, r"preset\.recipe\.tune_steps: 3, not 4"),
        ({"preprocessing": Preprocessing(36, 36)}, r"preset\.model\.preprocessing\.height: 32, not 36"),
    ],
)
def test_a_folder_of_another_run_is_refused_before_any_training(
    places: list[TrainingPlace], tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    teacher = Teacher()
    other = compared(places, tmp_path, train_model=teacher, setup=replace(SETUP, **change))
    with pytest.raises(ModelError, match=f"outcome of another run .{told}.: choose another folder"):
        other.run([CONV, GEM], seeds=[0])
    assert teacher.taught == []


def test_what_an_older_version_wrote_without_a_setting_is_the_same_run(
    places: list[TrainingPlace], tmp_path: Path
) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    path = tmp_path / "gem" / "seed0" / "result.json"
    told = json.loads(path.read_text())
    del told["preset"]["recipe"]["tuned_share"]
    path.write_text(json.dumps(told))
    teacher = Teacher()
    compared(places, tmp_path, train_model=teacher).run([GEM], seeds=[0])
    assert teacher.taught == []
    told["preset"]["recipe"]["tuned_share"] = 0.5  # but another value of it is another run
    path.write_text(json.dumps(told))
    with pytest.raises(ModelError, match=r"tuned_share: 0\.5, not 1\.0"):
        compared(places, tmp_path).run([GEM], seeds=[0])


def test_other_places_are_another_run(places: list[TrainingPlace], tmp_path: Path) -> None:
    compared(places, tmp_path).run([GEM], seeds=[0])
    with pytest.raises(ModelError, match=r"data\.cities\.set: 6, not 5"):
        compared(places[1:], tmp_path).run([GEM], seeds=[0])


def test_what_cannot_be_built_stops_everything_at_once(places: list[TrainingPlace], tmp_path: Path) -> None:
    teacher = Teacher()
    with pytest.raises(SaladError):  # 64 tokens are no more than 64 clusters
        compared(places, tmp_path, train_model=teacher).run([GEM, GridRow("salad", "SALAD", blocks=1)], seeds=[0])
    assert teacher.taught == []


def test_a_row_without_training_is_fitted(places: list[TrainingPlace], tmp_path: Path) -> None:
    teacher = Teacher()
    made = compared(places, tmp_path, train_model=teacher).run([VLAD], seeds=[0, 1])["vlad"]
    assert teacher.taught == []
    assert [one.parameters["trained"] for one in made] == [0, 0]
    assert all(one.seconds["training"] >= 0 for one in made)  # it keeps no log
    assert made[0].fingerprint != made[1].fingerprint  # the seed decides the vocabulary
    rows = load(tmp_path / "vlad" / "seed0" / "model").describe([np.zeros((32, 32, 3), np.uint8)])
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-3)


def test_without_places_held_out_there_is_no_precision(places: list[TrainingPlace], tmp_path: Path) -> None:
    setup = replace(SETUP, recipe=replace(SETUP.recipe, held_out=0.0))
    (found,) = compared(places, tmp_path, setup=setup).run([GEM], seeds=[0])["gem"]
    assert found.held_out == {}


def test_the_time_left_is_told(places: list[TrainingPlace], tmp_path: Path) -> None:
    said: list[str] = []
    compared(places, tmp_path, say=said.append).run([GEM, CONV], seeds=[0])
    assert "gem, seed 0: 1 of 2 runs" in said
    assert "measuring on town" in said
    assert any(line.startswith("1 of 2 runs made, about ") for line in said)


def test_data_are_known_by_names_wherever_they_lie(places: list[TrainingPlace], tmp_path: Path) -> None:
    moved = [replace(place, photos=tuple(tmp_path / photo.name for photo in place.photos)) for place in places]
    assert data_summary(moved[::-1]) == data_summary(places)
    assert data_summary(places[:5])["digest"] != data_summary(places)["digest"]
    assert data_summary(places)["cities"] == {"set": 6}


def test_milliseconds_are_of_one_photo() -> None:
    class Counting:
        preprocessing = Preprocessing(4, 6)

        def __init__(self) -> None:
            self.batches: list[int] = []

        def describe(self, photos: list[np.ndarray], *, batch_size: int) -> None:
            assert all(photo.shape == (4, 6, 3) for photo in photos)
            self.batches.append(len(photos))

    model: Any = Counting()
    assert milliseconds_a_photo(model, photos=3, rounds=2) >= 0
    assert model.batches == [3, 3, 3]
