"""`salad weights`: the zoo shown, fetched from a server on this machine, converted."""

from __future__ import annotations

import shutil
import urllib.error
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file

import salad
from salad.images.exif import save_jpeg
from salad.models import hub
from salad.models.model_folder import write_folder
from salad.network.baseline_config import SceneConfig, VladConfig
from salad.network.config import LiteConfig, ModelConfig, Preprocessing


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own."""
    monkeypatch.setenv("SALAD_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """An address on this machine; what lies in `tmp_path / "www"` is published there."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    folder = tmp_path / "www"
    folder.mkdir()
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as http:
        thread = Thread(target=http.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{http.server_port}"
        http.shutdown()
        thread.join()


def published(name: str, monkeypatch: pytest.MonkeyPatch, **change: Any) -> hub.ZooEntry:
    """Put a row of the zoo elsewhere."""
    row = replace(hub.ZOO[name], **change)
    monkeypatch.setitem(hub.ZOO, name, row)
    return row


def test_list_names_every_model(cli: Any) -> None:
    ran = cli("weights", "list")
    assert (ran.code, ran.err) == (0, "")
    lines = ran.out.splitlines()[1:]
    assert [line.split()[0] for line in lines] == list(hub.ZOO)
    rows = cli("weights", "list", "--format", "json").json()
    assert [row["name"] for row in rows] == list(hub.ZOO)
    assert all(set(row) == {"name", "here", "licence", "note"} for row in rows)
    for row, line in zip(rows, lines, strict=True):
        assert row["licence"] in line  # nothing is cut off where it is piped
        assert row["note"] in line


def test_list_says_what_is_here(cli: Any, home: Path) -> None:
    path = hub.path_of("megaloc")
    path.parent.mkdir(parents=True)
    path.touch()
    here = {row["name"]: row["here"] for row in cli("weights", "list", "--format", "json").json()}
    assert here["megaloc"] is True
    assert here["dinov2-salad"] is False


def test_info_tells_where_weights_lie(cli: Any, home: Path) -> None:
    ran = cli("weights", "info", "dinov2-salad")
    assert (ran.code, ran.err) == (0, "")
    row = hub.ZOO["dinov2-salad"]
    for fact in (row.url, row.licence, str(row.dim), str(hub.path_of("dinov2-salad"))):
        assert fact in ran.out


@pytest.mark.parametrize("command", ["info", "fetch"])
def test_an_unknown_name_is_refused(cli: Any, command: str) -> None:
    ran = cli("weights", command, "no-such")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("salad: no weights are called 'no-such': the zoo has salad-lite,")


def test_fetch_brings_the_file_once(
    cli: Any, server: str, home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "www" / "w.safetensors").write_bytes(b"weights")
    row = published("megaloc", monkeypatch, url=f"{server}/w.safetensors")
    ran = cli("weights", "fetch", "megaloc")
    path = home / "weights" / "megaloc" / row.file
    assert (ran.code, ran.out) == (0, f"{path}\n")
    assert path.read_bytes() == b"weights"
    assert row.licence in ran.err
    (tmp_path / "www" / "w.safetensors").unlink()
    assert cli("weights", "fetch", "megaloc").code == 0


def test_fetch_without_a_network_says_which_file_to_put_where(
    cli: Any, monkeypatch: pytest.MonkeyPatch, server: str
) -> None:
    row = published("megaloc", monkeypatch, url=f"{server}/no-such-file")
    ran = cli("weights", "fetch", "megaloc")
    assert (ran.code, ran.out) == (2, "")
    sentence = ran.err.splitlines()[-1]
    assert sentence.startswith("salad: could not fetch 'megaloc'")
    assert row.url in sentence
    assert str(hub.path_of("megaloc")) in sentence
    assert "Traceback" not in ran.err


def test_offline_is_told_the_same_way(cli: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*_: Any, **__: Any) -> None:
        raise urllib.error.URLError("Network is unreachable")

    monkeypatch.setattr("salad.models.hub._receive", offline)
    ran = cli("weights", "fetch", "dinov2-vits14")
    assert ran.code == 2
    assert "no connection: Network is unreachable" in ran.err
    assert hub.ZOO["dinov2-vits14"].url in ran.err


# --- convert -------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.torch
def test_a_published_file_becomes_a_folder_that_gives_the_same(cli: Any, shared: Path, tmp_path: Path) -> None:
    file, folder = shared / "golden" / "salad_flat.ckpt", tmp_path / "models" / "converted [1]"
    ran = cli("weights", "convert", file, "--to", folder, "--heads", 2)
    assert (ran.code, ran.out) == (0, f"{folder}\n")
    known = load_file(shared / "golden" / "salad_io.safetensors")
    size = next(key for key in known if key.endswith("descriptor")).rpartition(".")[0]
    import torch

    with torch.no_grad():
        found = salad.load(folder)(torch.from_numpy(known[f"{size}.image"]).float())
    np.testing.assert_allclose(found.numpy(), known[f"{size}.descriptor"], atol=1e-5)
    again = cli("weights", "convert", file, "--to", folder, "--heads", 2)
    assert again.code == 2
    assert "exists already" in again.err


@pytest.mark.parametrize(
    "content", [None, *(pytest.param(content, marks=pytest.mark.torch) for content in (b"", b"no weights"))]
)
def test_convert_refuses_what_is_no_file_of_weights(cli: Any, tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "file.ckpt"
    if content is not None:
        file.write_bytes(content)
    ran = cli("weights", "convert", file, "--to", tmp_path / "to")
    assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert "file.ckpt" in ran.err
    assert not (tmp_path / "to").exists()


# --- vocabulary ----------------------------------------------------------------------------


def tiny_model(to: Path, *, seed: int = 0) -> Path:
    """A model's folder, untrained."""
    from salad.network.network import build

    config = ModelConfig("tiny", LiteConfig(blocks=1), SceneConfig(16), Preprocessing(24, 24))
    return write_folder(build(config, seed=seed), to)


@pytest.fixture
def street(cli: Any, photos: Any, tmp_path: Path) -> tuple[Path, Path]:
    """An index of photos, and the folder of the tiny model it was made with."""
    model, city = tiny_model(tmp_path / "tiny"), tmp_path / "city.index"
    kept = shutil.copytree(photos.references, tmp_path / "photos")
    assert cli("index", kept, "--to", city, "--model", model).code == 0
    return city, model


@pytest.mark.torch
def test_a_vocabulary_from_an_index_is_a_model(cli: Any, street: tuple[Path, Path], tmp_path: Path) -> None:
    (city, model), to = street, tmp_path / "anyloc"
    gone, other = (tmp_path / "photos" / name for name in ("me@home 3.jpg", "-dash 5.jpg"))
    gone.unlink()
    save_jpeg(np.zeros((24, 24, 3), dtype=np.uint8), other)  # not what the index holds: it is not opened for it
    ran = cli("weights", "vocabulary", "--index", city, "--model", model, "--to", to, "--clusters", 5)
    assert (ran.code, ran.out) == (0, f"{to}\n")
    assert ran.err.count("\n") == 2
    for photo in (gone, other):
        assert f"{photo} was changed or is gone" in ran.err
    made = salad.load(to)
    assert made.config.aggregator == VladConfig(16, clusters=5)
    assert made.name == "tiny-vlad"
    rows = made.describe(sorted((tmp_path / "photos").iterdir()))
    assert rows.shape == (5, 80)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    assert cli("index", tmp_path / "photos", "--to", tmp_path / "again.index", "--model", to).code == 0


@pytest.mark.torch
def test_a_vocabulary_goes_where_nothing_is(cli: Any, street: tuple[Path, Path], tmp_path: Path) -> None:
    city, model = street
    before = (model / "config.json").read_bytes()
    ran = cli("weights", "vocabulary", "--index", city, "--model", model, "--to", model)
    assert (ran.code, ran.out) == (2, "")
    assert "tiny exists already; choose another folder" in ran.err
    assert (model / "config.json").read_bytes() == before
    ran = cli("weights", "vocabulary", "--index", city, "--model", model, "--to", tmp_path / "a", "--clusters", 0)
    assert ran.code == 2
    assert "--clusters 0 is too few" in ran.err


@pytest.mark.torch
def test_a_vocabulary_of_a_model_nobody_knows_asks_for_it(cli: Any, street: tuple[Path, Path], tmp_path: Path) -> None:
    ran = cli("weights", "vocabulary", "--index", street[0], "--to", tmp_path / "a")
    assert ran.code == 2
    assert "was made with 'tiny', which is not in the zoo" in ran.err
    assert not (tmp_path / "a").exists()


# --- mean ----------------------------------------------------------------------------------


@pytest.mark.torch
def test_a_mean_of_two_is_a_model(cli: Any, tmp_path: Path) -> None:
    two = [tiny_model(tmp_path / f"{seed}", seed=seed) for seed in range(2)]
    to = tmp_path / "mean"
    ran = cli("weights", "mean", *two, "--to", to)
    assert (ran.code, ran.out) == (0, f"{to}\n")
    first, second, made = (load_file(folder / "model.safetensors") for folder in (*two, to))
    for name, weight in made.items():
        if weight.dtype.kind == "f":
            np.testing.assert_allclose(weight, (first[name] + second[name]) / 2, rtol=1e-6, atol=1e-7)
    again = cli("weights", "mean", *two, "--to", two[0])
    assert again.code == 2
    assert "exists already" in again.err


@pytest.mark.torch
def test_a_mean_of_one_is_a_sentence(cli: Any, tmp_path: Path) -> None:
    ran = cli("weights", "mean", "salad-lite", "--to", tmp_path / "mean")
    assert (ran.code, ran.out) == (2, "")
    assert "a mean takes two models or more, not 1" in ran.err
    assert not (tmp_path / "mean").exists()
