"""Equal terms: what is the same for every row is the same, and a row's own settings are its own."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from safetensors.torch import save_file

from salad.ablation.grid_setup import GridSetup, check_presets, default_recipe, grid_setup, row_preset, start_digest
from salad.ablation.grids import ALL_BLOCKS, GRIDS, GridRow, grid_rows
from salad.errors import ModelError, TooFewTokensError, WeightsError
from salad.network.aggregator_config import SaladConfig
from salad.network.backbones.base import build_backbone
from salad.network.baseline_config import MixVprConfig
from salad.network.config import LiteConfig, Preprocessing, ViTConfig
from salad.network.network import build
from salad.training.recipe import LITE_PHOTO, PRESETS, Recipe

STEPS = Recipe(head_steps=1, tune_steps=3)
TINY = GridSetup(LiteConfig(blocks=4), 8, Preprocessing(72, 72), "", STEPS)


def vit_file(path: Path, depth: int = 3) -> str:
    weights = build_backbone(ViTConfig(64, depth, 1, grid=3)).state_dict()
    save_file({name: value for name, value in weights.items() if not name.startswith("norm.")}, path)
    return str(path)


def test_imagenet_starts_lite0_and_a_file_its_own_vit(tmp_path: Path) -> None:
    lite = grid_setup(side=224, recipe=STEPS)
    assert (lite.backbone, lite.stride, lite.blocks, lite.token_grid) == (LiteConfig(), 16, 11, (14, 14))
    assert lite.preprocessing == replace(LITE_PHOTO, height=224, width=224)
    start = vit_file(tmp_path / "a.safetensors")
    vit = grid_setup(start, side=56, recipe=STEPS)
    assert (vit.backbone, vit.stride, vit.token_grid) == (ViTConfig(64, 3, 1, grid=3), 14, (4, 4))
    assert vit.preprocessing == Preprocessing(56, 56)
    assert grid_setup(start, side=56, recipe=STEPS, depth=2).blocks == 2


def test_a_start_or_a_depth_that_cannot_be_is_a_sentence(tmp_path: Path) -> None:
    start = vit_file(tmp_path / "a.safetensors")
    with pytest.raises(ModelError, match=r"4 blocks cannot be kept: .*a\.safetensors holds 3"):
        grid_setup(start, side=56, recipe=STEPS, depth=4)
    with pytest.raises(ModelError, match="a file's backbone alone: give --start"):
        grid_setup(side=56, recipe=STEPS, depth=4)
    with pytest.raises(WeightsError, match="gone"):
        grid_setup(str(tmp_path / "gone.safetensors"), side=56, recipe=STEPS)
    save_file(
        build(row_preset(TINY, grid_rows("sizes")[0], seed=0).model).state_dict(),
        tmp_path / "own.safetensors",
    )
    with pytest.raises(WeightsError, match=r"own\.safetensors: its tensors .* no layout"):
        grid_setup(str(tmp_path / "own.safetensors"), side=56, recipe=STEPS)


def test_the_budget_is_a_small_presets() -> None:
    assert default_recipe("imagenet") == PRESETS["small"].recipe
    assert default_recipe("some.pth") == PRESETS["salad-vits"].recipe
    assert default_recipe("some.pth", frozen=True) == default_recipe("imagenet", frozen=True) == PRESETS["head"].recipe


@pytest.mark.parametrize("grid", GRIDS)
def test_every_row_becomes_a_preset_on_the_same_terms(grid: str) -> None:
    lite = grid_setup(side=224, recipe=PRESETS["small"].recipe)
    made = [(row, row_preset(lite, row, seed=2)) for row in grid_rows(grid)]
    own = {"seed", "tuned_blocks", "size", "head_steps", "tune_steps"}
    common = {key: value for key, value in asdict(lite.recipe).items() if key not in own}
    for row, each in made:
        recipe = each.recipe
        assert {key: value for key, value in asdict(recipe).items() if key not in own} == common
        assert recipe.seed == 2
        assert recipe.tuned_blocks == (11 if row.blocks == ALL_BLOCKS else row.blocks)
        assert recipe.size == (160 if row.fewer_tokens else None)
        steps = recipe.head_steps + recipe.tune_steps
        assert steps == (0 if row.fitted else 200)
        assert (each.start, each.model.name) == ("imagenet", row.name)
        assert (each.model.backbone, each.model.preprocessing) == (lite.backbone, lite.preprocessing)
    heads = [each.model.aggregator for _, each in made]
    assert len({str(head) for head in heads}) == (1 if grid == "blocks" else len(heads) - (grid == "parts") * 2)


def test_a_head_without_weights_takes_its_steps_with_the_backbone() -> None:
    by_name = {row.name: row for row in grid_rows("aggregators")}
    assert row_preset(TINY, by_name["average"], seed=0).recipe.tune_steps == 4
    assert row_preset(TINY, by_name["gem"], seed=0).recipe.head_steps == 1  # its power is learnt
    frozen = row_preset(TINY, replace(by_name["average"], blocks=0), seed=0).recipe
    assert frozen.head_steps + frozen.tune_steps == 0


@pytest.mark.parametrize("grid", ["aggregators", "parts", "sizes"])
def test_under_a_frozen_backbone_no_row_trains_a_block(grid: str) -> None:
    recipe = default_recipe("imagenet", frozen=True).of_steps(30)
    made = [row_preset(grid_setup(side=224, recipe=recipe), row, seed=0) for row in grid_rows(grid)]
    assert all(each.recipe.tuned_blocks == each.recipe.tune_steps == 0 for each in made)
    without = {each.model.name for each in made if each.recipe.head_steps == 0}
    assert without == ({"average", "class-token", "vlad"} if grid == "aggregators" else set())
    assert {each.recipe.head_steps for each in made} <= {0, 30}


def test_what_depends_on_the_number_of_tokens_is_made_for_it() -> None:
    mixer = row_preset(TINY, GridRow("mixvpr", "MixVPR", "mixvpr"), seed=0).model.aggregator
    assert isinstance(mixer, MixVprConfig)
    assert mixer.grid == (9, 9)


def test_a_row_that_cannot_be_is_a_sentence() -> None:
    with pytest.raises(ModelError, match="row a trains 5 blocks, but the backbone has 4"):
        row_preset(TINY, GridRow("a", "A", blocks=5), seed=0)
    with pytest.raises(ModelError, match="row a asks for an aggregator 'none'"):
        row_preset(TINY, GridRow("a", "A", "none"), seed=0)


def test_what_cannot_describe_is_said_before_any_training() -> None:
    whole = row_preset(TINY, GridRow("whole", "W"), seed=0)
    check_presets([whole, row_preset(TINY, GridRow("vlad", "V", "vlad", fitted=True), seed=0)])
    small = replace(TINY, preprocessing=Preprocessing(64, 64))  # 64 tokens for 64 clusters
    with pytest.raises(TooFewTokensError):
        check_presets([row_preset(small, GridRow("whole", "W"), seed=0)])
    fewer = row_preset(TINY, GridRow("fewer", "F", fewer_tokens=True), seed=0)
    assert isinstance(fewer.model.aggregator, SaladConfig)
    assert fewer.recipe.size == 48
    with pytest.raises(TooFewTokensError):  # enough tokens in use, too few in training
        check_presets([fewer])


def test_a_start_is_known_by_what_is_in_it(tmp_path: Path) -> None:
    (tmp_path / "a.pth").write_bytes(b"weights")
    assert start_digest(str(tmp_path / "a.pth")) == {
        "name": "a.pth",
        "sha256": hashlib.sha256(b"weights").hexdigest(),
    }
    assert start_digest("") == {"name": "", "sha256": ""}
    assert len(start_digest("imagenet")["sha256"]) == 64
