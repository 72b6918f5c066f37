"""The contract that every engine keeps, and what the torch engine keeps besides."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import pickle
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

import salad
from salad.errors import MissingExtraError, ModelError, WeightsError
from salad.models.describer import Describer
from salad.models.engines import Engine, EngineName
from salad.models.fake import FakeEngine
from salad.models.model_folder import add_graph, load, write_folder
from salad.models.quantize import Reduced, quantized
from salad.models.torch_engine import TorchEngine
from salad.network.aggregator_config import RouteConfig, SaladConfig
from salad.network.baseline_config import GemConfig, NetVladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing, ViTConfig
from salad.network.export import made_pictures
from salad.network.network import Network, build, evaluating

SALAD = SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=5, hidden=8)
VIT = ModelConfig("vit", ViTConfig(16, 1, 2, grid=3), SALAD, Preprocessing(42, 56))
LITE = ModelConfig("lite", LiteConfig(blocks=1), SALAD, Preprocessing(24, 16))
PLAIN = dataclasses.replace(VIT, aggregator=GemConfig(16))
ROUTE = dataclasses.replace(VIT, aggregator=RouteConfig(16, SALAD))


def _torch(config: ModelConfig) -> Callable[[], Engine]:
    return lambda: TorchEngine.of(build(config))


_FOLDERS = tempfile.TemporaryDirectory(prefix="salad-engines-")  # of exported models, for as long as the tests run


def _onnx(config: ModelConfig, name: EngineName = "onnx") -> Callable[[], Engine]:
    def engine() -> Engine:
        folder = Path(_FOLDERS.name) / hashlib.sha256(repr(config).encode()).hexdigest()[:8]
        if not folder.exists():
            add_graph(write_folder(build(config), folder, dtype="float16"))
        try:
            return load(folder, engine=name).engine
        except MissingExtraError as error:
            pytest.skip(str(error))

    return engine


def _quantized(config: ModelConfig, precision: Reduced) -> Callable[[], Engine]:
    def engine() -> Engine:
        given = _onnx(config, "openvino")()
        learnt = made_pictures(config.preprocessing, 16)
        made = quantized(Describer(config, given), learnt, precision=precision).engine
        try:
            made.run(learnt[:1])
        except ModelError as error:
            pytest.skip(str(error))  # where the processor has no such instructions, which the sentence says
        return made

    return engine


# An engine more is a line here: what makes it, for photos of a size of its own choice.
ENGINES: dict[str, Callable[[], Engine]] = {
    "fake": FakeEngine,
    "fake, wide": lambda: FakeEngine(dim=300, size=(30, 50), clusters=7),
    "torch, vit": _torch(VIT),
    "torch, lite": _torch(LITE),
    "torch, no plan": _torch(PLAIN),
    "torch, route": _torch(ROUTE),
    "onnx, vit": _onnx(VIT),
    "onnx, lite": _onnx(LITE),
    "onnx, no plan": _onnx(PLAIN),
    "onnx, route": _onnx(ROUTE),
    "openvino, vit": _onnx(VIT, "openvino"),
    "openvino, lite": _onnx(LITE, "openvino"),
    "openvino, no plan": _onnx(PLAIN, "openvino"),
    "openvino, route": _onnx(ROUTE, "openvino"),
    "openvino, vit in bf16": _quantized(VIT, "bf16"),
    "openvino, lite in bf16": _quantized(LITE, "bf16"),
    "openvino, vit in int8": _quantized(VIT, "int8"),
    "openvino, lite in int8": _quantized(LITE, "int8"),
}


@pytest.fixture(scope="module", params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Engine:
    return ENGINES[request.param]()


def photos(engine: Engine, count: int, *, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (count, *engine.size, 3), dtype=np.uint8)


class TestContract:
    """What every engine keeps."""

    @pytest.mark.parametrize("count", [0, 1, 2, 5])
    def test_every_output_has_a_row_for_each_photo(self, engine: Engine, count: int) -> None:
        found = engine.run(photos(engine, count), engine.outputs)
        assert list(found) == list(engine.outputs)
        assert {one.dtype for one in found.values()} == {np.dtype(np.float32)}
        assert {len(one) for one in found.values()} == {count}
        _, rows, columns, width = found["patches"].shape
        assert found["cls"].shape == (count, width)
        assert found["descriptor"].ndim == 2
        if "plan" in found:
            assert found["plan"].shape[2:] == (rows, columns)

    def test_descriptors_are_what_is_given_unless_asked_and_have_length_one(self, engine: Engine) -> None:
        found = engine.run(photos(engine, 3))
        assert list(found) == ["descriptor"]
        np.testing.assert_allclose(np.linalg.norm(found["descriptor"], axis=1), 1, atol=1e-6)

    def test_every_token_is_shared_out_whole(self, engine: Engine) -> None:
        if "plan" not in engine.outputs:
            with pytest.raises(ModelError, match="no output 'plan': ask for descriptor, patches, cls"):
                engine.run(photos(engine, 1), ("plan",))
            return
        plan = engine.run(photos(engine, 2), ("plan",))["plan"]
        np.testing.assert_allclose(plan.sum(axis=1), 1, atol=1e-5)
        assert plan.min() >= 0

    def test_a_photo_gives_the_same_in_any_batch_and_again(self, engine: Engine) -> None:
        five = photos(engine, 5)
        together = engine.run(five, engine.outputs)
        for name, again in engine.run(five, engine.outputs).items():
            np.testing.assert_array_equal(again, together[name])
        for split in ([1, 2], [4]):
            for part, at in zip(np.split(five, split), np.split(np.arange(5), split), strict=True):
                for name, one in engine.run(part, engine.outputs).items():
                    np.testing.assert_allclose(one, together[name][at], rtol=1e-4, atol=1e-5)

    def test_different_photos_are_told_apart(self, engine: Engine) -> None:
        one, other = engine.run(photos(engine, 2))["descriptor"]
        assert float(one @ other) < 1 - 1e-6

    def test_threads_get_what_one_would(self, engine: Engine) -> None:
        batches = [photos(engine, 2, seed=seed) for seed in range(8)]
        expected = [engine.run(batch)["descriptor"] for batch in batches]
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda batch: engine.run(batch)["descriptor"], batches))
        for one, due in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, due, rtol=1e-5, atol=1e-6)

    @pytest.mark.parametrize("change", ["higher", "four channels", "one photo", "floats", "channels first"])
    def test_what_it_cannot_take_is_a_sentence(self, engine: Engine, change: str) -> None:
        sound = photos(engine, 2)
        bad = {
            "higher": np.concatenate([sound, sound], axis=1),
            "four channels": np.concatenate([sound, sound[..., :1]], axis=3),
            "one photo": sound[0],
            "floats": sound.astype(np.float32),
            "channels first": np.moveaxis(sound, 3, 1),
        }[change]
        height, width = engine.size
        with pytest.raises(ModelError, match=rf"cannot be run: this model takes uint8 \[batch, {height}, {width}, 3"):
            engine.run(bad)

    def test_an_output_there_is_not_is_named(self, engine: Engine) -> None:
        with pytest.raises(ModelError, match="no output 'depth': ask for descriptor, patches"):
            engine.run(photos(engine, 1), ("depth",))  # type: ignore[arg-type]  # that is the test

    def test_its_weights_are_arrays_that_stay_while_nobody_trains(self, engine: Engine) -> None:
        first, again = engine.weights(), engine.weights()
        assert list(first) == list(again)
        for name, values in first.items():
            assert isinstance(values, np.ndarray)
            np.testing.assert_array_equal(values, again[name])

    def test_photos_are_left_as_they_are(self, engine: Engine) -> None:
        given = photos(engine, 2)
        before = given.copy()
        engine.run(given, engine.outputs)
        np.testing.assert_array_equal(given, before)

    def test_photos_may_be_mirrored_and_read_only(self, engine: Engine) -> None:
        given = photos(engine, 2)
        given.flags.writeable = False
        due = engine.run(given[..., ::-1].copy())["descriptor"]
        np.testing.assert_array_equal(engine.run(given[..., ::-1])["descriptor"], due)
        assert engine.run(given)["descriptor"].shape == due.shape

    def test_it_can_be_copied_and_pickled(self, engine: Engine) -> None:
        given = photos(engine, 2)
        for other in (copy.deepcopy(engine), pickle.loads(pickle.dumps(engine))):
            np.testing.assert_array_equal(other.run(given)["descriptor"], engine.run(given)["descriptor"])


class TestTorchEngine:
    """What torch's engine keeps besides."""

    def test_it_gives_what_the_network_gives(self) -> None:
        network = build(VIT)
        engine = TorchEngine.of(network)
        given = photos(engine, 2)
        with torch.no_grad():
            images = network.normalise(torch.from_numpy(given))
            tokens = network.tokens(images)
            expected = {
                "descriptor": network(images),
                "patches": tokens.patches.reshape(2, 3, 4, 16),
                "cls": tokens.cls,
                "plan": network.aggregator.plan(tokens).reshape(2, 5, 3, 4),
            }
        for name, found in engine.run(given, engine.outputs).items():
            np.testing.assert_allclose(found, expected[name].numpy(), atol=1e-6)

    def test_dropout_is_off_and_the_mode_stays(self) -> None:
        network = build(VIT)
        engine = TorchEngine.of(network)
        due = engine.run(photos(engine, 2))["descriptor"]
        network.train()
        np.testing.assert_array_equal(engine.run(photos(engine, 2))["descriptor"], due)
        assert network.training

    def test_each_part_stays_in_its_mode(self) -> None:
        network = build(VIT).train()
        network.backbone.eval()  # frozen, while the aggregator is trained
        modes = [part.training for part in network.modules()]
        engine = TorchEngine.of(network)
        engine.run(photos(engine, 1))
        assert [part.training for part in network.modules()] == modes

    def test_who_leaves_first_does_not_change_the_mode_for_others(self) -> None:
        """As two threads may: the first to come leaves while the second is still at work."""
        network = build(VIT).train()
        first, second = evaluating(network), evaluating(network)
        first.__enter__()
        with second:
            first.__exit__()
            assert not any(part.training for part in network.modules())
        assert all(part.training for part in network.modules())

    def test_a_copy_is_trained_by_itself(self) -> None:
        model = Describer.of(build(VIT))
        other, before = copy.deepcopy(model), model.fingerprint
        with torch.no_grad():
            other.network.aggregator.feature[0].weight.neg_()
        assert other.fingerprint != before == model.fingerprint

    def test_what_is_loaded_in_inference_mode_can_be_trained(self, tmp_path: Path) -> None:
        write_folder(build(VIT), tmp_path / "m")
        with torch.inference_mode():
            model = salad.load(tmp_path / "m")
        model(torch.randn(2, 3, 42, 56)).sum().backward()

    def test_what_is_trained_shows_at_once(self) -> None:
        network = build(VIT)
        model = Describer.of(network)
        photo, before = photos(model.engine, 1)[0], model.fingerprint
        first = model.describe([photo])
        with torch.no_grad():
            network.aggregator.feature[0].weight.neg_()
        assert model.fingerprint == network.fingerprint != before
        assert np.abs(model.describe([photo]) - first).max() > 1e-4

    def test_gradients_reach_the_weights_of_what_is_called(self) -> None:
        model = Describer.of(build(VIT))
        model(torch.randn(2, 3, 42, 56)).sum().backward()
        grads = [weight.grad for weight in model.network.parameters()]
        assert all(grad is not None for grad in grads)

    def test_eight_threads_load_one_network(self) -> None:
        read: list[int] = []
        weights = build(LITE).weights()

        def slowly() -> dict[str, np.ndarray]:
            read.append(1)
            return weights

        engine = TorchEngine(LITE, slowly, source=Path("lite"))
        assert engine.device == "cpu"
        assert read == []
        with ThreadPoolExecutor(8) as pool:
            networks = set(pool.map(lambda _: engine.network, range(8)))
        assert len(networks) == len(read) == 1

    def test_weights_that_do_not_fit_are_said_when_they_are_needed(self) -> None:
        engine = TorchEngine(LITE, lambda: build(VIT).weights(), source=Path("other.safetensors"))
        with pytest.raises(WeightsError, match=r"other\.safetensors does not fit .* missing: backbone\._"):
            engine.run(photos(engine, 1))


@pytest.mark.parametrize("name", ["salad-lite", "salad-vits", "salad-lite-route"])
def test_a_fingerprint_is_the_same_from_the_file_alone(name: str) -> None:
    """Without torch, or before a network is loaded, it is made of the arrays on disk, float16 and all."""
    folder = Path(salad.__file__).parent / "weights" / name
    model = salad.load(name)
    assert model.config.fingerprint(load_file(folder / "model.safetensors")) == model.fingerprint


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize(
    "config", [LITE, VIT, dataclasses.replace(VIT, aggregator=NetVladConfig(16, clusters=3))], ids=str
)
def test_counters_and_flags_count_in_a_fingerprint(config: ModelConfig, dtype: str, tmp_path: Path) -> None:
    """A batch norm's counter is an integer without axes, NetVLAD's `fitted` a truth value."""
    network = build(config)
    stored = load_file(write_folder(network, tmp_path / "m", dtype=dtype) / "model.safetensors")
    assert config.fingerprint(stored) == salad.load(tmp_path / "m").fingerprint
    if dtype == "float32":
        assert config.fingerprint(stored) == network.fingerprint
    flags = [key for key, value in stored.items() if value.dtype.kind in "ib"]
    for key in flags:
        changed = {**stored, key: np.asarray(stored[key] + 1, stored[key].dtype)}
        assert config.fingerprint(changed) != config.fingerprint(stored)
    assert bool(flags) == (config is not VIT)


def test_a_module_is_made_of_an_engines_weights_or_nothing_changes() -> None:
    model = Describer(dataclasses.replace(VIT, preprocessing=Preprocessing(64, 64)), FakeEngine(17))
    assert model.describe([np.zeros((64, 64, 3), np.uint8)]).shape == (1, model.dim)
    assert model.token_assignment(np.zeros((9, 9, 3), np.uint8)).dustbin.shape == (8, 8)
    with pytest.raises(WeightsError, match="vit does not fit the model it describes"):
        assert isinstance(model.network, Network)
    assert isinstance(model.engine, FakeEngine)
