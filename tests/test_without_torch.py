"""Where torch is not installed: everything that needs no network works, and what needs one says what is missing.

Each in a process of its own, since torch cannot be taken out of one that has it. `scripts/test` runs the command line's
own suite in such processes too.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import salad

HIDES_TORCH = Path(__file__).with_name("without_torch")
TOO_MUCH = {"torch", "onnx", "onnxscript", "kornia", "lightning_fabric", "transformers"}
TRAIN = re.compile(r"needs the 'train' extra: pip install 'salad-vpr\[train\]'$")
TORCH = re.compile(r"needs the 'torch' extra: pip install 'salad-vpr\[torch\]'$")


def python(*arguments: object) -> subprocess.CompletedProcess[str]:
    """A Python that cannot import torch."""
    path = os.pathsep.join([str(HIDES_TORCH), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


def succeeds(code: str, *arguments: object) -> str:
    ran = python("-c", code, *arguments)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_only_the_network_and_what_trains_it_imports_torch() -> None:
    """So that no test which is skipped for want of torch hides that another room has come to need it."""
    code = """
import importlib, pkgutil, salad
for module in pkgutil.walk_packages(salad.__path__, "salad."):
    try:
        if module.name != "salad.__main__":
            importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        print(module.name, error.name)
"""
    refused = dict(line.split() for line in succeeds(code).splitlines())
    assert set(refused.values()) == {"torch"}
    assert {name.split(".")[1] for name in refused} == {"network", "training", "ablation"}
    # What a model and a run are stays data that anybody can read.
    assert not {name for name in refused if name.endswith(("config", "recipe", "grids", "run_result", "comparison"))}


def test_photos_are_indexed_found_and_located(tmp_path: Path) -> None:
    code = """
import sys
from pathlib import Path
import numpy as np
from PIL import Image
import salad
from salad.models.fake import FakeDescriber

home, model = Path(sys.argv[1]), FakeDescriber()
paths = [home / f"{number}@48.1{number}@11.5@.png" for number in range(6)]
for number, path in enumerate(paths):
    pixels = np.random.default_rng(number).integers(0, 256, (6, 6, 3), dtype=np.uint8)
    Image.fromarray(pixels).resize((96, 96)).save(path)
made = {"dim": model.dim, "fingerprint": model.fingerprint, "model": model.name}
with salad.Index.create(home / "i", **made) as index:
    photos = [salad.Photo(path, salad.GeoPoint(48 + number / 100, 11.5)) for number, path in enumerate(paths)]
    index.add(photos, model.describe(paths), identities=[f"{number:032x}" for number in range(6)])
with salad.Index.open(home / "i") as index:
    answers = [salad.locate(path, index=index, model=model, min_confidence=0) for path in paths]
assert [answer.matches[0].photo.path for answer in answers] == paths
assert all(answer.place is not None for answer in answers)
"""
    succeeds(code, tmp_path)


def test_nothing_that_describes_photos_loads_it_where_it_is(tmp_path: Path) -> None:
    """With the model that ships, and torch at hand; what the workers load is seen where it is hidden, in tests/cli."""
    chance = np.random.default_rng(0)
    for side in ("references", "queries"):
        (tmp_path / side).mkdir()
        for number in range(2):
            pixels = chance.integers(0, 256, (6, 6, 3), dtype=np.uint8)
            Image.fromarray(pixels).resize((96, 96)).save(tmp_path / side / f"{number}.png")
    commands = [
        "index references --to a.index",
        "locate queries/0.png --index a.index --min-confidence 0 --format json",
        "evaluate --references references --queries queries --frames 0",
        "verify a.index",
        "info a.index",
        "export a.index --to out",
        "index --from out --to b.index",
        "merge a.index b.index",
        "compact a.index",
        "remove references/0.png --index a.index",
        "datasets list",
        "weights list",
        "weights info salad-lite",
    ]
    code = """
import json, sys
from salad.cli.main import run
for line in json.load(sys.stdin):
    code = run(line.split())
    assert code in (0, 1), line
print("loaded:", *sys.modules)
"""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(commands),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert not TOO_MUCH & set(ran.stdout.partition("loaded:")[2].split())


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("train --data {0} --to {0}/run", TRAIN),
        ("train --dry-run", TRAIN),
        ("weights vocabulary --index {0} --to {0}/vlad", TRAIN),
        ("weights convert {0}/a.ckpt --to {0}/model", TORCH),
        ("weights mean salad-lite salad-lite-route --to {0}/mean", TORCH),
        ("index {0}/set --to {0}/index --model {0}/a.ckpt", TORCH),
        ("index {0}/set --to {0}/index --model dinov2-salad", TORCH),  # said before it is fetched
        ("compare --grid sizes --to {0}/runs --data {0}/set --benchmark town {0}/set/b {0}/set/c frames:0", TRAIN),
    ],
)
def test_a_command_that_needs_it_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, extra: re.Pattern[str]
) -> None:
    (tmp_path / "a.ckpt").write_bytes(b"")
    for place in "bcde":
        (tmp_path / "set" / place).mkdir(parents=True)
        for number in range(4):
            Image.new("RGB", (9, 9)).save(tmp_path / "set" / place / f"{number}.png")
    monkeypatch.setenv("SALAD_HOME", str(tmp_path / "home"))
    before = sorted(tmp_path.rglob("*"))
    ran = python("-m", "salad", *command.format(tmp_path).split())
    assert (ran.returncode, ran.stdout) == (2, "")
    assert extra.search(ran.stderr.splitlines()[-1]), ran.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_a_model_describes_and_only_its_module_is_refused() -> None:
    code = """
import numpy as np
import salad

model = salad.load("salad-lite")
print(model.name, model.dim, model.fingerprint, model.preprocessing.height, model.calibration.centred)
photo = np.zeros((9, 9, 3), np.uint8)
by_torch = salad.load("salad-lite", engine="torch")  # asked for, so it says what is missing where it is used
print(model.describe([photo]).shape, model.token_assignment(photo).dustbin.shape)
for ask in (lambda: model.network, lambda: model(None), lambda: by_torch.describe([photo])):
    try:
        ask()
    except salad.SaladError as error:
        print(error)
"""
    told, shapes, *refused = succeeds(code).splitlines()
    assert told == "salad-lite 8448 ea968928572f4e59 320 True"
    sentence = "running a model by torch needs the 'torch' extra: pip install 'salad-vpr[torch]'"
    assert shapes == "(1, 8448) (20, 20)"
    assert refused == [sentence] * 3


@pytest.mark.parametrize("room", ["cli", "models", "index", "localize", "evaluation", "report", "datasets", "search"])
def test_no_room_has_tensors_from_safetensors(room: str) -> None:
    """The imports of torch itself are import-linter's to find; a package's torch half is not."""
    for file in (Path(salad.__file__).parent / room).rglob("*.py"):
        assert not re.search(r"safetensors\.torch|utils\.dlpack|\.from_numpy", file.read_text(encoding="utf-8")), file
