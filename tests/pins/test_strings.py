"""What is looked up by a name in a string, where a rename breaks it in silence: held by what comes of it.

A model's dustbin and its calibration are asked for with `getattr` and done without where they are not found; the
processes that decode photos are started by a module's name and done without where they do not start.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import salad
from pins.facts import draw_streets
from pins.where import Calibration, FakeDescriber, salad_says, street


@pytest.fixture(scope="module")
def model() -> salad.Describer:
    return salad.load("salad-lite")


def test_a_page_shows_what_the_dustbin_took(tmp_path: Path) -> None:
    """Layers over photos are the page's only PNGs; a page without a model has none."""
    draw_streets(tmp_path)
    folders = ("--references", tmp_path / "references", "--queries", tmp_path / "queries")
    truth, page, result = tmp_path / "truth.csv", tmp_path / "page.html", tmp_path / "result.json"
    truth.write_text("query,positives\n" + "".join(f"{n}.png,{7 - n}.png\n" for n in range(3)), encoding="utf-8")
    judged = salad_says("evaluate", *folders, "--truth", truth, "--report", page, "--save", result)
    assert judged.code == 0, judged.err
    assert "data:image/png;base64" in page.read_text(encoding="utf-8")
    plain = ("evaluate", "--result", result, "--report", page)
    assert salad_says(*plain).code == 0
    assert "data:image/png;base64" not in page.read_text(encoding="utf-8")
    assert salad_says(*plain, *folders, "--heat").code == 0  # a saved result shows photos of folders named now
    assert "data:image/png;base64" in page.read_text(encoding="utf-8")


def test_a_model_shares_its_tokens_out(model: salad.Describer) -> None:
    with pytest.warns(DeprecationWarning, match="token_assignment"):  # the old name, for one release
        share = model.share(street(1))
    assert share.dustbin.shape == share.cluster.shape == (20, 20)
    assert share.dustbin.dtype == np.float32
    assert abs(float(share.dustbin.mean()) - 0.35) < 0.05  # what the shipped model's dustbin wants of all tokens
    assert (share.cluster.min() >= 0, share.cluster.max() < 128) == (True, True)


@pytest.mark.parametrize("own", [True, False])
def test_a_place_is_as_sure_as_the_models_own_calibration_says(
    own: bool, model: salad.Describer, tmp_path: Path
) -> None:
    """One reference alone, so that nothing is scattered or stands elsewhere: z = bias + top * score + share."""
    describer = model if own else FakeDescriber()
    by = model.calibration if own else Calibration()
    assert by is not None
    assert by.centred is own
    path = tmp_path / "query.png"
    street(1, seed=1).save(path)
    reference, query = describer.describe([street(1), street(1, seed=1)])
    made = {"dim": describer.dim, "fingerprint": describer.fingerprint, "model": describer.name}
    with salad.Index.create(tmp_path / "i", **made) as index:
        photo = salad.Photo(Path("/photos/a.jpg"), salad.GeoPoint(48.1, 11.5))
        index.add([photo], reference[None], identities=["a" * 32])
        answer = salad.locate(path, index=index, model=describer, min_confidence=0.0)
        (wanted,) = index.search(query, centred=own)[0]
    assert answer.matches[0].score == pytest.approx(wanted.score, abs=1e-5)
    assert answer.place is not None
    z = by.bias + by.top * answer.matches[0].score + by.share
    assert answer.place.confidence == pytest.approx(1 / (1 + math.exp(-z)), abs=1e-9)


def test_judging_leaves_out_what_all_have_in_common_where_the_model_says_so(tmp_path: Path) -> None:
    table, _ = draw_streets(tmp_path)
    folders = ("--references", tmp_path / "references", "--queries", tmp_path / "queries")
    said = [
        salad_says("evaluate", *folders, "--radius", 25, "--table", table, *more).err for more in ((), ("--plain",))
    ]
    assert ["what all references have in common" in one for one in said] == [True, False]


@pytest.mark.parametrize("photos", [40, 1])
def test_photos_are_decoded_in_processes_of_their_own(
    photos: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is opened here, be it one alone."""
    paths = [tmp_path / f"{number}.png" for number in range(photos)]
    for number, path in enumerate(paths):
        street(number, side=24).save(path)
    opened: list[object] = []
    real = Image.open

    def trap(source: object, *rest: object, **more: object) -> Image.Image:
        opened.append(source)
        return real(source, *rest, **more)

    monkeypatch.setattr(Image, "open", trap)
    fake = FakeDescriber()
    with salad.Index.create(tmp_path / "i", dim=32, fingerprint=fake.fingerprint, model="fake") as index:
        done = salad.index_photos(paths, index, fake)
        assert (done.added, done.unreadable) == (photos, [])
        answers = list(salad.locate_many(paths, index=index, model=fake, k=1))
    assert [answer.matches[0].photo.path for answer in answers] == paths
    assert opened == []
    Image.open(paths[0]).close()
    assert opened == [paths[0]]  # the trap works
