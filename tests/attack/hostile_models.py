"""Model folders that somebody made to be loaded: the shipped model, damaged by hand."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import salad
from attack.attacks import Attack, Command
from attack.outside import Scene

SHIPPED = Path(salad.__file__).parent / "weights" / "salad-lite"
CONFIG, WEIGHTS, GRAPH = "config.json", "model.safetensors", "graph.onnx"
USED: tuple[Command, ...] = (("index", "{photos}/1.jpg", "--to", "{work}/new", "--model", "{given}/model"),)


def copied(scene: Scene) -> Path:
    """A sound model, to be damaged."""
    folder = scene.given / "model"
    shutil.copytree(SHIPPED, folder)
    return folder


def says(*where: str | int, value: Any, graph: bool = True) -> Callable[[Scene], None]:
    """A model whose `config.json` says something else at a place; `graph` is whether it keeps its graph."""

    def make(scene: Scene) -> None:
        folder = copied(scene)
        config = json.loads((folder / CONFIG).read_text())
        inner: Any = config
        for name in where[:-1]:
            inner = inner[name]
        inner[where[-1]] = value
        if not graph:
            del config["files"]
            (folder / GRAPH).unlink()
        (folder / CONFIG).write_text(json.dumps(config))

    return make


def holds(name: str, content: bytes, *, size: int = 0) -> Callable[[Scene], None]:
    """A model one of whose files is something else, and says it has `size` bytes where that is more."""

    def make(scene: Scene) -> None:
        folder = copied(scene)
        with (folder / name).open("wb") as file:
            file.write(content)
            if size:
                file.truncate(size)
        _agree(folder)

    return make


def _agree(folder: Path) -> None:
    """Let `config.json` have the checksums of the files as they are, where they are not too long to be read."""
    import hashlib

    config = json.loads((folder / CONFIG).read_text())
    for name in config["files"]:
        if (folder / name).stat().st_size < 1 << 26:
            config["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    (folder / CONFIG).write_text(json.dumps(config))


def is_a(name: str, how: Callable[[Scene, Path], object]) -> Callable[[Scene], None]:
    """A model one of whose names stands for something else."""

    def make(scene: Scene) -> None:
        path = copied(scene) / name
        path.unlink()
        how(scene, path)

    return make


def tensors(header: bytes, *, length: int | None = None) -> bytes:
    """A file of weights whose header is that, and says it has `length` bytes."""
    return struct.pack("<Q", len(header) if length is None else length) + header


def configs() -> Iterator[Attack]:
    """Numbers beyond all sense, in a model with a graph and in one that torch would have to build."""
    settings: list[tuple[tuple[str | int, ...], tuple[Any, ...]]] = [
        (("preprocessing", "height"), (10**9, 10**18, 10**30, -1, 0, 1.5, "320", True, None)),
        (("preprocessing", "width"), (10**5, 10**9)),
        (("backbone", "blocks"), (10**6, 10**12, -1, 0, "15", True)),
        (("aggregator", "clusters"), (10**9, 10**5, 0, -1, 1.5)),
        (("aggregator", "cluster_dim"), (10**9, 0)),
        (("aggregator", "scene_dim"), (10**9, -1)),
        (("aggregator", "hidden"), (10**9, -1)),
        (("aggregator", "width"), (10**9, 121)),
        (("aggregator", "dropout"), ("x", -1.0, 1e308)),
        (("aggregator", "linear"), (10**9,)),
        (("preprocessing", "std", 0), (0.0, float("nan"), float("inf"), "x", -1.0)),
        (("preprocessing", "mean"), ([], [0.5] * 100_000, "xyz")),
        (("preprocessing", "resample"), ("x", 5, None)),
        (("backbone", "kind"), ("x" * 10_000, "../x", None, 5)),
        (("backbone",), (None, [], "lite2", {})),
        (("aggregator",), (None, [], {})),
        (("calibration", "sharpness"), (float("nan"), float("inf"), "x")),
        (("format",), (10**30, -1, None, "1", 1.5, True)),
    ]
    for where, values in settings:
        for value in values:
            for graph in (True, False):
                shown = (
                    repr(value)
                    if len(repr(value)) < 20
                    else f"{value:.0e}"
                    if isinstance(value, int)
                    else repr(value)[:16]
                )
                name = f"{'.'.join(map(str, where))} is {shown}{'' if graph else ', without a graph'}"
                # Where torch has to be imported for a sentence, tests/long waits for it.
                every = graph and value in (10**9, 10**5, 10**6)
                yield used(name, says(*where, value=value, graph=graph), every=every, long=not graph)
    for name in ("\x1b]0;owned\x07", "a\nb", "\ud800", "m" * 1_000_000, "../../x", 5, None):
        yield used(f"a name of {str(name)[:10]!r}", says("name", value=name), right="harmless")
    for value in (
        {"../../outside/note.txt": "0"},
        {"/etc/passwd": "0"},
        [1],
        "x",
        {"graph.onnx": 5},
        {"graph.onnx": "0"},
    ):
        yield used(f"files are {value}", says("files", value=value))
    for what, content in {
        "lists 100,000 deep": b"[" * 100_000,
        "objects 100,000 deep": b'{"format":' * 100_000,
        "no text": b"\xff\xfe",
        "nothing": b"",
        "a list": b"[]",
        "a number of a million digits": b'{"format":' + b"9" * 1_000_000 + b"}",
    }.items():
        yield used(f"config.json is {what}", is_a(CONFIG, lambda _, path, content=content: path.write_bytes(content)))

    def endless(_: Scene, path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(5 << 30)

    yield used("config.json has 5 GB", is_a(CONFIG, endless))


def weights() -> Iterator[Attack]:
    """Files of weights, and graphs, that lie."""
    for what, content in {
        "a header of 2^60 bytes": tensors(b"{}", length=1 << 60),
        "a header of 2^64 bytes": tensors(b"{}", length=(1 << 64) - 1),
        "a header 100,000 deep": tensors(b"[" * 100_000),
        "a header of objects 10,000 deep": tensors(b'{"a":' * 10_000),
        "a shape of 2^62": tensors(
            b'{"x":{"dtype":"F32","shape":[4611686018427387904],"data_offsets":[0,4]}}') + b"abcd",
        "a shape of 10^26": tensors(
            b'{"x":{"dtype":"F32","shape":[100000000000000000000000000],"data_offsets":[0,4]}}') + b"abcd",
        "a negative shape": tensors(b'{"x":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}}') + b"abcd",
        "offsets beyond the end": tensors(b'{"x":{"dtype":"F32","shape":[1],"data_offsets":[0,400000]}}'),
        "offsets that run back": tensors(b'{"x":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}}') + b"abcd",
        "no weights": tensors(b"{}"),
        "nothing": b"",
        "text": b"weights, weights, weights",
        "a pickle": pickle.dumps({"state_dict": 5}),
    }.items():  # fmt: skip
        for graph in (True, False):
            made = holds(WEIGHTS, content) if graph else _bare(holds(WEIGHTS, content))
            yield used(f"weights are {what}{'' if graph else ', without a graph'}", made, long=not graph)
    yield used("weights have 1 TB", holds(WEIGHTS, tensors(b"{}"), size=1 << 40), long=True)
    yield used("the graph has 100 GB", holds(GRAPH, b"\x08\x08", size=100 << 30), long=True)
    for what, content in {
        "nothing": b"",
        "text": b"graph, graph",
        "zeros": bytes(4096),
        "\\xff": b"\xff" * 4096,
    }.items():
        yield used(f"the graph is {what}", holds(GRAPH, content))
    yield used("the graph's weights are outside", _reaching_out, every=True)
    for name in (CONFIG, WEIGHTS, GRAPH):
        yield used(f"{name} is a pipe", is_a(name, lambda _, path: os.mkfifo(path)))
        yield used(f"{name} is a link to an endless device", is_a(name, lambda _, path: path.symlink_to("/dev/zero")))
        yield used(f"{name} is a folder", is_a(name, lambda _, path: path.mkdir()))
        yield used(f"{name} is a link to nothing", is_a(name, lambda _, path: path.symlink_to("nowhere")))


def _bare(make: Callable[[Scene], None]) -> Callable[[Scene], None]:
    def without(scene: Scene) -> None:
        make(scene)
        folder = scene.given / "model"
        config = json.loads((folder / CONFIG).read_text())
        del config["files"]
        (folder / CONFIG).write_text(json.dumps(config))
        (folder / GRAPH).unlink()

    return without


def _reaching_out(scene: Scene) -> None:
    """A graph that names, in place of `model.safetensors`, a file outside of its folder, by a name as long."""
    folder = copied(scene)
    graph, there = (folder / GRAPH).read_bytes(), b"../../outside/x.f"
    assert len(there) == len(WEIGHTS)
    shutil.copy(folder / WEIGHTS, scene.outside / "x.f")
    (folder / GRAPH).write_bytes(graph.replace(WEIGHTS.encode(), there))
    _agree(folder)


class Dropped:
    """What a pickle runs when it is read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch ran",)


def published() -> Iterator[Attack]:
    """Published files, which are pickles: what they would run is never run."""
    for end in ("pth", "ckpt", "pt", "bin"):

        def make(scene: Scene, end: str = end) -> None:
            (scene.given / f"weights.{end}").write_bytes(pickle.dumps({"state_dict": Dropped()}))

        commands: tuple[Command, ...] = (
            ("index", "{photos}/1.jpg", "--to", "{work}/new", "--model", f"{{given}}/weights.{end}"),
            ("weights", "convert", f"{{given}}/weights.{end}", "--to", "{work}/model"),
        )
        yield Attack(
            f"a published file .{end} that runs something",
            make,
            commands=commands,
            names="" if end == "bin" else f"weights.{end}",
            real_models=True,
            memory=3 << 30,
            also=lambda scene: ["it ran"] if (scene.work / "ran").exists() else [],
            long=True,
        )


def used(
    name: str, make: Callable[[Scene], object], *, right: Any = "refused", every: bool = False, long: bool = False
) -> Attack:
    """A model that somebody describes a photo by."""
    names = "model" if right == "refused" else ""
    return Attack(f"a model: {name}", make, right, names, USED, 2 << 30, real_models=True, every=every, long=long)


ALL = [attack for some in (configs, weights, published) for attack in some()]
