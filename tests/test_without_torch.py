"""Where torch is not installed: everything that needs no network works, and what needs one says what is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import salad

# In a process of its own, since torch cannot be taken out of one that has it.
REFUSE = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "kornia", "lightning_fabric", "torchvision", "transformers"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
"""


def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", REFUSE + code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


def test_photos_are_indexed_found_and_located(tmp_path: Path) -> None:
    code = """
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
assert not {"torch", "safetensors.torch"} & sys.modules.keys()
"""
    ran = run(code, tmp_path)
    assert ran.returncode == 0, ran.stderr
    for arguments, said in ((["info", tmp_path / "i"], "photos"), (["--help"], "locate")):
        ran = run("from salad.cli.main import main; main(sys.argv[1:])", *arguments)
        assert ran.returncode == 0, ran.stderr
        assert said in ran.stdout


def test_a_model_describes_and_only_its_module_is_refused() -> None:
    code = """
import numpy as np
import salad

model = salad.load("salad-lite")
print(model.name, model.dim, model.fingerprint, model.preprocessing.height, model.calibration.centred)
photo = np.zeros((9, 9, 3), np.uint8)
print(model.describe([photo]).shape, model.token_assignment(photo).dustbin.shape)
for ask in (lambda: model.network, lambda: model(None)):
    try:
        ask()
    except salad.SaladError as error:
        print(error)
"""
    ran = run(code)
    assert ran.returncode == 0, ran.stderr
    told, shapes, *refused = ran.stdout.splitlines()
    assert told == "salad-lite 8448 ea968928572f4e59 320 True"
    sentence = "running a model by torch needs the 'torch' extra: pip install 'salad-vpr[torch]'"
    assert shapes == "(1, 8448) (20, 20)"
    assert refused == [sentence] * 2


def test_a_published_file_needs_torch_to_be_read(tmp_path: Path) -> None:
    (tmp_path / "a.ckpt").write_bytes(b"")
    ran = run(
        "from salad.cli.main import main; main(sys.argv[1:])",
        "locate",
        tmp_path / "a.ckpt",
        "--index",
        tmp_path,
    )
    assert ran.returncode == 2
    code = "import salad; salad.load(sys.argv[1])"
    assert (
        "MissingExtraError: running a model by torch needs the 'torch' extra" in run(code, tmp_path / "a.ckpt").stderr
    )


@pytest.mark.parametrize("room", ["cli", "models", "index", "localize", "evaluation", "report", "datasets", "search"])
def test_no_room_has_tensors_from_safetensors(room: str) -> None:
    """The imports of torch itself are import-linter's to find; a package's torch half is not."""
    for file in (Path(salad.__file__).parent / room).rglob("*.py"):
        assert not re.search(r"safetensors\.torch|utils\.dlpack|\.from_numpy", file.read_text(encoding="utf-8")) or (
            file.name == "torch_engine.py"
        ), file
