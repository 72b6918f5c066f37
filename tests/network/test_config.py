"""Configurations: both ways through JSON, the paper's widths, and damaged ones refused."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import salad
from salad.errors import ModelError
from salad.network.aggregator_config import (
    AGGREGATOR_KINDS,
    PRESETS,
    RouteConfig,
    SaladConfig,
    aggregator_kind,
    compared_aggregators,
)
from salad.network.baseline_config import (
    AverageConfig,
    BoqConfig,
    ConvApConfig,
    CosPlaceConfig,
    GemConfig,
    MixVprConfig,
    NetVladConfig,
    SceneConfig,
    VladConfig,
)
from salad.network.config import (
    BACKBONE_KINDS,
    VITS,
    Calibration,
    ConvNextConfig,
    LiteConfig,
    LiteKind,
    ModelConfig,
    Preprocessing,
    ResNetConfig,
    ViTConfig,
    check_sizes,
)

few = st.integers(1, 4096)
stages = st.integers(1, 4)
pairs = st.tuples(few, few)
channels = st.tuples(*[st.floats(0.01, 1) | st.just(1)] * 3)
backbones = (
    st.builds(ViTConfig, few, few, few, few, few, st.sampled_from([0, 4]), st.booleans())
    | st.builds(LiteConfig, st.integers(1, 16), st.sampled_from(get_args(LiteKind)))
    | st.builds(ResNetConfig, stages)
    | st.builds(ConvNextConfig, st.sampled_from(["tiny", "base"]), stages)
)


def salads(width: int) -> st.SearchStrategy[SaladConfig]:
    sizes = [st.just(width), few, few, st.integers(0, 512), few, st.floats(0, 0.9), st.none() | few]
    transports = st.sampled_from(["sinkhorn", "softmax", "dual-softmax"])
    shares = st.floats(0.01, 0.99)
    return st.builds(SaladConfig, *sizes, st.booleans(), transports, st.integers(1, 9)) | st.builds(
        SaladConfig, *sizes, iterations=st.integers(1, 9), dustbin_share=shares
    )


def routes(width: int) -> st.SearchStrategy[RouteConfig]:
    return st.builds(RouteConfig, st.just(width), salads(width), few, few, st.floats(0, 9) | st.just(1))


aggregators = (
    few.flatmap(salads)
    | few.flatmap(routes)
    | st.builds(SceneConfig, few)
    | st.builds(AverageConfig, few)
    | st.builds(GemConfig, few, st.floats(1, 9), st.booleans())
    | st.builds(NetVladConfig, few, few, st.none() | few)
    | st.builds(VladConfig, few, few)
    | st.builds(MixVprConfig, few, pairs, few, few, few, few)
    | st.builds(ConvApConfig, few, few, pairs)
    | st.builds(CosPlaceConfig, few, few, st.floats(1, 9))
    | few.flatmap(lambda heads: st.builds(BoqConfig, few, st.just(3 * heads), few, few, few, st.just(heads)))
)
preparations = st.builds(Preprocessing, few, few, channels, channels, st.sampled_from(["bilinear", "bicubic"]))
weights = st.floats(0, 1e6)
calibrations = st.builds(
    Calibration,
    weights,
    st.floats(-1e6, 1e6),
    *[weights] * 4,
    st.floats(1e-6, 1e3),
    st.floats(0, 1),
    st.text(),
    st.booleans(),
)
models = st.builds(
    ModelConfig,
    st.text(),
    backbones,
    aggregators,
    preparations,
    st.text(),
    st.text(),
    st.none() | calibrations,
)


def _plain() -> dict[str, Any]:
    return ModelConfig("a", LiteConfig(), PRESETS["small"]).as_dict()


@settings(deadline=None, max_examples=60)
@given(models)
def test_json_brings_back_the_same_model(config: ModelConfig) -> None:
    text = json.dumps(config.as_dict())
    again = ModelConfig.from_dict(json.loads(text))
    assert again == config
    assert json.dumps(again.as_dict()) == text  # to the letter: fingerprints are made of it


@pytest.mark.parametrize(("name", "dim"), [("full", 8448), ("medium", 2112), ("small", 544)])
def test_presets_are_the_papers(name: str, dim: int) -> None:
    preset = PRESETS[name]
    assert (preset.dim, preset.hidden, preset.dropout, preset.width) == (dim, 512, 0.3, 768)


def test_a_final_linear_layer_decides_the_width() -> None:
    assert SaladConfig(width=768, cluster_dim=256, linear=8448).dim == 8448
    assert SceneConfig(width=7).dim == GemConfig(width=7).dim == 7


def test_dinov2_has_heads_of_64_numbers_and_the_giant_a_swiglu() -> None:
    assert {name: config.width // config.heads for name, config in VITS.items()} == dict.fromkeys(VITS, 64)
    assert [name for name, config in VITS.items() if config.swiglu] == ["vitg14"]


def test_reading_leaves_the_given_settings_alone() -> None:
    settings_, before = _plain(), _plain()
    ModelConfig.from_dict(settings_)
    assert settings_ == before


@pytest.mark.parametrize(
    ("part", "setting", "value", "said"),
    [
        (
            "backbone",
            "kind",
            "resnet",
            "kind 'resnet' is unknown; known are vit, lite0, lite2, resnet50, convnext",
        ),
        ("aggregator", "kind", None, "kind None is unknown; known are salad, netvlad, gem, average"),
        ("aggregator", "temperature", 3, "temperature"),
        ("preprocessing", "mean", [0.5, 0.5], "three numbers"),
        ("preprocessing", "std", [1.0, 1.0, 0.0], "std above 0"),
        ("preprocessing", "std", [1.0, 1.0, float("nan")], "three numbers"),
        ("preprocessing", "mean", "abc", "real number"),
        ("preprocessing", "height", 0, "whole pixels"),
        ("preprocessing", "width", "322", "whole pixels"),
        ("preprocessing", "resample", "magic", "bilinear, bicubic"),
        ("preprocessing", "gamma", 2, "gamma"),
        ("preprocessing", "height", 4097, "at most 4096"),
        ("preprocessing", "width", 10**9, "at most 4096"),
        ("preprocessing", "height", 10**400, "at most 4096"),
        ("preprocessing", "width", 1e3, "whole pixels"),
        ("preprocessing", "mean", [0.5, 0.5, 10**400], "cannot be read"),
        ("preprocessing", "mean", [1e300, 0.5, 0.5], "values in 0..1"),
        ("preprocessing", "std", [1e-300, 0.5, 0.5], "values in 0..1"),
        ("aggregator", "iterations", 10**9, "1000 at most"),
    ],
)
def test_a_damaged_setting_is_named(part: str, setting: str, value: object, said: str) -> None:
    data = _plain()
    data[part][setting] = value
    with pytest.raises(ModelError, match=said):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("lost", ["name", "backbone", "aggregator", "preprocessing"])
def test_a_lost_part_is_named(lost: str) -> None:
    data = _plain()
    del data[lost]
    with pytest.raises(ModelError, match=lost):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("data", [None, 3, {"backbone": 3, "aggregator": [], "preprocessing": ""}])
def test_what_is_no_configuration_is_refused(data: Any) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("text", [3, None, ["a"], "\ud800", "a" * 70_000])
@pytest.mark.parametrize("name", ["name", "provenance", "licence"])
def test_what_people_read_of_a_model_is_text(name: str, text: object) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        ModelConfig.from_dict({**_plain(), name: text})


VAST = ModelConfig("a", LiteConfig(), SaladConfig(9, clusters=4096, cluster_dim=4096))


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (ModelConfig("a", ViTConfig(16, 10**6, 2), SceneConfig(16)), "1000000 blocks are more than any model has"),
        (ModelConfig("a", LiteConfig(), MixVprConfig(9, depth=300)), "300 blocks"),
        (ModelConfig("a", LiteConfig(), BoqConfig(9, blocks=257)), "257 blocks"),
        (ModelConfig("a", LiteConfig(), SceneConfig(0)), "a descriptor of 0 numbers"),
        (ModelConfig("a", LiteConfig(), SaladConfig(9, clusters=-3)), "a descriptor of -128 numbers"),
        (ModelConfig("a", LiteConfig(), RouteConfig(9, SaladConfig(9), grid=10**6)), "a descriptor of 32"),
        (VAST, "a descriptor of 16777472 numbers cannot be: 1 to 1,048,576 can"),
    ],
)
def test_a_model_that_no_machine_can_run_is_told_from_its_sizes(config: ModelConfig, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        check_sizes(config)


@pytest.mark.parametrize("width", [112, 384, 1536])
def test_every_model_that_is_compared_is_of_a_size_that_can_be(width: int) -> None:
    for backbone in (*VITS.values(), LiteConfig(), ResNetConfig(), ConvNextConfig()):
        for aggregator in compared_aggregators(width).values():
            check_sizes(ModelConfig("a", backbone, aggregator))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=8,
)
PLACES = [(part, name) for part, held in _plain().items() if isinstance(held, dict) for name in held]


@settings(deadline=None, max_examples=300)
@given(where=st.sampled_from([*PLACES, ("calibration", None), ("name", None), ("precision", None)]), value=JSON)
def test_any_value_in_any_place_is_read_or_a_sentence(where: tuple[str, str | None], value: object) -> None:
    data = _plain()
    if where[1] is None:
        data[where[0]] = value
    else:
        data[where[0]][where[1]] = value
    with suppress(ModelError):
        ModelConfig.from_dict(data)


def test_a_model_nobody_has_calibrated_says_nothing_of_it() -> None:
    assert "calibration" not in _plain()
    assert ModelConfig.from_dict(_plain()).calibration is None
    assert ModelConfig.from_dict({**_plain(), "calibration": None}).calibration is None


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [
        ("sharpness", -1.0, "sharpness"),
        ("top", -0.1, "top"),
        ("gap", float("nan"), "gap"),
        ("spread", "2", "spread"),
        ("share", True, "share"),
        ("bias", float("inf"), "bias"),
        ("radius", 0, "radius 0 must be above 0"),
        ("min_confidence", 1.01, "at most 1"),
        ("centred", 1, "give true or false"),
        ("colour", 1, "nothing else and nothing less"),
        ("sharpness", 1e7, "none over 1,000,000"),
        ("bias", -1e300, "none over"),
        ("top", 10**400, "none over"),
    ],
)
def test_a_damaged_calibration_is_named(setting: str, value: object, said: str) -> None:
    data = {**_plain(), "calibration": {**Calibration().as_dict(), setting: value}}
    with pytest.raises(ModelError, match=said):
        ModelConfig.from_dict(data)


@pytest.mark.parametrize("data", [3, [], {"bias": 1.0}])
def test_what_is_no_calibration_is_refused(data: Any) -> None:
    with pytest.raises(ModelError, match="a calibration holds"):
        Calibration.from_dict(data)


def test_nobody_can_change_a_configuration() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PRESETS["full"].clusters = 3


def test_it_imports_no_torch() -> None:
    code = "import sys, salad.network.config, salad.training.recipe; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- what came after the first models ------------------------------------------------------

SHIPPED = Path(salad.__file__).parent / "weights"


@pytest.mark.parametrize(("name", "later"), [("salad-lite", {"dustbin_share"}), ("salad-vits", set())])
def test_the_config_that_ships_is_written_as_it_was(name: str, later: set[str]) -> None:
    """Its fingerprint is made of it: no later setting may turn up in it, but those that it was trained with."""
    data = json.loads((SHIPPED / name / "config.json").read_text(encoding="utf-8"))
    version, _ = data.pop("format"), data.pop("files")  # the folder's own words, not the model's
    first = {"width", "clusters", "cluster_dim", "scene_dim", "hidden", "dropout", "linear", "kind"}
    assert set(data["aggregator"]) == first | later
    again = json.loads(json.dumps({"format": version, **ModelConfig.from_dict(data).as_dict()}))
    assert again == {"format": version, **data}


@pytest.mark.parametrize(
    ("config", "later"),
    [
        (SaladConfig(9), set()),
        (SaladConfig(9, dustbin=False), {"dustbin"}),
        (SaladConfig(9, transport="softmax", iterations=4), {"transport", "iterations"}),
        (SaladConfig(9, dustbin_share=0.4), {"dustbin_share"}),
        (GemConfig(9), set()),
        (GemConfig(9, learned=True), {"learned"}),
    ],
    ids=["salad", "no-dustbin", "softmax", "dustbin-share", "gem", "learned-gem"],
)
def test_a_later_setting_is_written_where_it_is_not_the_default(config: Any, later: set[str]) -> None:
    written = ModelConfig("a", LiteConfig(), config).as_dict()["aggregator"]
    assert set(written) & {"dustbin", "transport", "iterations", "dustbin_share", "learned"} == later


@pytest.mark.parametrize("share", [None, 0.4])
def test_a_route_writes_what_came_later_of_the_salad_inside_it_too(share: float | None) -> None:
    route = RouteConfig(9, SaladConfig(9, dustbin_share=share))
    written = ModelConfig("a", LiteConfig(), route).as_dict()["aggregator"]["salad"]
    assert ("dustbin_share" in written) == (share is not None)
    assert {"dustbin", "transport", "iterations"} < set(written)  # as it always was


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"dustbin_share": 0.0}, "between 0 and 1"),
        ({"dustbin_share": 1}, "between 0 and 1"),
        ({"dustbin_share": True}, "between 0 and 1"),
        ({"dustbin_share": float("nan")}, "between 0 and 1"),
        ({"dustbin_share": "half"}, "between 0 and 1"),
        ({"dustbin_share": 0.4, "dustbin": False}, "needs a dustbin"),
        ({"dustbin_share": 0.4, "transport": "softmax"}, "needs a dustbin"),
    ],
)
def test_a_senseless_share_of_the_dustbin_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        SaladConfig(9, **change)


def test_every_kind_is_written_as_it_is_read() -> None:
    for kinds in (BACKBONE_KINDS, {kind: aggregator_kind(kind) for kind in AGGREGATOR_KINDS}):
        for kind, made in kinds.items():
            assert kind in get_args(get_type_hints(made)["kind"])
            if list(kinds.values()).count(made) == 1:
                defaults = {field.name: field.default for field in dataclasses.fields(made)}
                assert defaults["kind"] == kind


def test_the_names_that_are_compared() -> None:
    assert list(compared_aggregators(112)) == [
        *("salad", "salad-no-dustbin", "salad-no-scene", "salad-softmax", "salad-dual-softmax"),
        *(
            "netvlad",
            "netvlad-linear",
            "gem",
            "average",
            "class-token",
            "mixvpr",
            "conv-ap",
            "cosplace",
            "boq",
        ),
        *("vlad", "salad-route"),
    ]
    assert compared_aggregators(768)["salad"] == PRESETS["full"]
    assert compared_aggregators(112)["salad"] == SaladConfig(112, 64, 32, 128, 256)  # as salad-lite's


@pytest.mark.parametrize("width", [16, 112, 384, 768, 1024, 1536])
@pytest.mark.parametrize("name", compared_aggregators(768))
def test_each_is_of_the_width_asked_for_and_can_be_written(name: str, width: int) -> None:
    config = compared_aggregators(width)[name]
    model = ModelConfig("a", LiteConfig(), config)
    assert config.width == width
    assert config.dim > 0
    assert ModelConfig.from_dict(json.loads(json.dumps(model.as_dict()))) == model


def test_only_a_mixer_minds_the_grid() -> None:
    for name, made in compared_aggregators(112).items():
        config = made.for_grid((7, 9))
        if name == "mixvpr":
            assert isinstance(config, MixVprConfig)
            assert (config.grid, config.dim) == ((7, 9), 2048)
        else:
            assert config == made


@pytest.mark.parametrize(
    ("made", "settings_", "said"),
    [
        (SaladConfig, {"transport": "magic"}, "transport 'magic' is unknown: give one of sinkhorn, softmax"),
        (
            SaladConfig,
            {"iterations": 0},
            "iterations of the salad aggregator is 0: give a whole number, at least 1",
        ),
        (SaladConfig, {"iterations": 2.5}, "iterations of the salad aggregator is 2.5"),
        (SaladConfig, {"scene_dim": -1}, "scene_dim of the salad aggregator is -1: .* at least 0"),
        (SaladConfig, {"dustbin": "no"}, "dustbin of the salad aggregator is 'no': give true or false"),
        (NetVladConfig, {"clusters": 0}, "clusters of the netvlad aggregator is 0"),
        (NetVladConfig, {"linear": 0}, "linear of the netvlad aggregator is 0"),
        (VladConfig, {"clusters": True}, "clusters of the vlad aggregator is True"),
        (MixVprConfig, {"grid": (3,)}, r"grid of the mixvpr aggregator is \(3,\): give its rows and columns"),
        (MixVprConfig, {"grid": (0, 3)}, "at least 1 each"),
        (MixVprConfig, {"grid": 20}, "grid of the mixvpr aggregator is 20"),
        (MixVprConfig, {"depth": 0}, "depth of the mixvpr aggregator is 0"),
        (ConvApConfig, {"channels": "many"}, "channels of the conv-ap aggregator is 'many'"),
        (ConvApConfig, {"grid": ("2", "2")}, "grid of the conv-ap aggregator"),
        (CosPlaceConfig, {"linear": 0}, "linear of the cosplace aggregator is 0"),
        (BoqConfig, {"heads": 5}, "5 heads do not divide 384 channels"),
        (BoqConfig, {"queries": -3}, "queries of the boq aggregator is -3"),
        (RouteConfig, {"salad": SaladConfig(8)}, "must be one for tokens of 9 numbers"),
        (RouteConfig, {"salad": SaladConfig(9), "weight": -1.0}, "weight of the layout is -1.0"),
        (RouteConfig, {"salad": SaladConfig(9), "weight": float("nan")}, "weight of the layout is nan"),
        (RouteConfig, {"salad": SaladConfig(9), "grid": 0}, "grid of the salad-route aggregator is 0"),
    ],
)
def test_a_setting_that_makes_no_sense_is_a_sentence(made: Any, settings_: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        made(9, **settings_)


@pytest.mark.parametrize("stages_", [0, 5, "3", None])
def test_a_trunk_has_four_stages(stages_: Any) -> None:
    with pytest.raises(ModelError, match=f"stages is {stages_!r}, but ResNet-50 has 1 to 4"):
        ResNetConfig(stages=stages_)
    with pytest.raises(ModelError, match=f"stages is {stages_!r}, but ConvNeXt has 1 to 4"):
        ConvNextConfig(stages=stages_)
    with pytest.raises(ModelError, match="size 'huge' of ConvNeXt is unknown: give tiny or base"):
        ConvNextConfig(size="huge")
