"""The model zoo: one table of published and bundled weights, and where they lie on this machine.

Bundled weights are a folder inside the package. The others are fetched to `home()/weights/NAME/FILE`, where a
file downloaded by hand may be put just as well. A file whose checksum the table does not know has it recorded
beside it, in `FILE.sha256`, the first time it is used.
"""

from __future__ import annotations

import os
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import platformdirs

from salad.errors import FetchError, WeightsError
from salad.model.download import DownloadFailedError, Opener, Progress, check, download

Layout = Literal["flat", "megaloc", "hub", "own"]


@dataclass(frozen=True, slots=True)
class ZooEntry:
    """One row of the zoo.

    Attributes:
        name: What users call it.
        url: Where the file is published; None for weights inside the package.
        file: The file's name in the cache, or the folder's name inside the package.
        layout: How the file names its tensors; `own` is this package's folder format.
        dim: Numbers in what the model gives: a descriptor, or a bare backbone's token. None where the
            weights' own config says it.
        licence: What to show when the weights are loaded or fetched.
        sha256: The file's checksum, where its publisher states one.
        bytes: The file's length, where known.
        image_size: Side in pixels of the square a photo is squeezed to by default.
        note: What it is good for, in a sentence.
    """

    name: str
    url: str | None
    file: str
    layout: Layout
    dim: int | None
    licence: str
    sha256: str | None = None
    bytes: int | None = None
    image_size: int = 322
    note: str = ""


def _bundled(name: str, dim: int, note: str, *, image_size: int) -> ZooEntry:
    """Make the row of a model of ours, which lies inside the package."""
    return ZooEntry(
        name=name,
        url=None,
        file=name,
        layout="own",
        dim=dim,
        licence="Apache-2.0; trained on research photos, see docs/model-card.md",
        image_size=image_size,
        note=note,
    )


def _dinov2(letter: str, dim: int, registers: bool) -> ZooEntry:
    """Make the row of one DINOv2 backbone."""
    stem = f"dinov2_vit{letter}14"
    file = f"{stem}_{'reg4_' if registers else ''}pretrain.pth"
    return ZooEntry(
        name=f"dinov2-vit{letter}14{'-reg' if registers else ''}",
        url=f"https://dl.fbaipublicfiles.com/dinov2/{stem}/{file}",
        file=file,
        layout="hub",
        dim=dim,
        licence="Apache-2.0",
        note=f"DINOv2 backbone{' with 4 registers' if registers else ''}, to train a SALAD head on",
    )


_ENTRIES = (
    _bundled("salad-lite", 8448, "small, ships with the package, runs on any laptop", image_size=320),
    _bundled(
        "salad-lite-route",
        8960,
        "the same beside a 4 x 4 layout: for routes, webcams and trains alone, where the camera looks the same "
        "way again",
        image_size=320,
    ),
    _bundled(
        "salad-vits",
        8448,
        "ships with the package too: surer with webcams and phones in any light, slower, worse on thumbnails",
        image_size=322,
    ),
    ZooEntry(
        name="dinov2-salad",
        url="https://github.com/serizba/salad/releases/download/v1.0.0/dino_salad.ckpt",
        file="dino_salad.ckpt",
        layout="flat",
        dim=8448,
        licence="weights from a GPL-3.0 repository; trained on GSV-Cities, whose data are CC BY-NC-ND 4.0",
        note="the paper's full model: DINOv2 ViT-B/14 and SALAD",
    ),
    ZooEntry(
        name="megaloc",
        url="https://huggingface.co/gberton/MegaLoc/resolve/main/model.safetensors",
        file="model.safetensors",
        layout="megaloc",
        dim=8448,
        licence="MIT",
        note="DINOv2 ViT-B/14 and a larger SALAD, trained on five data sets at once",
    ),
    *(
        _dinov2(letter, dim, registers)
        for letter, dim in (("s", 384), ("b", 768), ("l", 1024), ("g", 1536))
        for registers in (False, True)
    ),
)

ZOO: dict[str, ZooEntry] = {entry.name: entry for entry in _ENTRIES}


def home() -> Path:
    """Give the folder for what is fetched: `SALAD_HOME` if set, else the platform's cache folder."""
    chosen = os.environ.get("SALAD_HOME")
    return Path(chosen).expanduser() if chosen else platformdirs.user_cache_path("salad")


def entry(name: str) -> ZooEntry:
    """Look up a row of the zoo.

    Raises:
        WeightsError: There is no such row.
    """
    if name not in ZOO:
        raise WeightsError(f"no weights are called '{name}': the zoo has {', '.join(ZOO)}")
    return ZOO[name]


def path_of(name: str) -> Path:
    """Say where weights of the zoo lie, or will lie once fetched."""
    row = entry(name)
    if row.url is None:
        return Path(__file__).resolve().parents[1] / "weights" / row.file
    return home() / "weights" / row.name / row.file


def fetch(name: str, *, progress: Progress | None = None, opener: Opener = urllib.request.urlopen) -> Path:
    """Make sure that weights of the zoo are on this machine.

    Whole files on disk are used without a network, their checksum compared every time.

    Args:
        name: A name in `ZOO`.
        progress: Told the bytes on disk and the bytes there will be (None where the server does not say).
        opener: What opens a request; by default the standard library.

    Returns:
        The file, or for bundled weights the folder.

    Raises:
        FetchError: The download failed; the message says which file to put where by hand.
        WeightsError: No such weights, or the file on disk is not the one it was.
    """
    row, path = entry(name), path_of(name)
    if row.url is None:
        if not path.is_dir():
            raise WeightsError(f"the bundled weights '{name}' are not at {path}: install the package again")
        return path
    if not path.is_file():
        try:
            download(row.url, path, sha256=row.sha256, size=row.bytes, progress=progress, opener=opener)
        except DownloadFailedError as error:
            raise FetchError(
                f"could not fetch '{name}' ({error}): try again, or download {row.url} "
                f"on a machine with a network and put it at {path}"
            ) from error
    check(path, sha256=row.sha256)
    return path
