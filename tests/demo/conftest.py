"""A small town of flat photos, and answers that are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from salad.demo.demo_result import DemoResult, Judged
from salad.demo.town.town import Town
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg
from salad.images.photo import Photo
from salad.index.index import Match
from salad.localize.locate import Answer
from salad.localize.voting import Place

HERE = GeoPoint(47.5, 64.5)
Paint = Callable[..., Town]
Result = Callable[..., DemoResult]


@pytest.fixture
def paint() -> Paint:
    """Stands for `draw_town` and draws noise, in no time."""

    def paint(
        to: Path,
        *,
        seed: int = 7,
        references: int = 4,
        queries: int = 3,
        name: str = "query_{}.jpg",
        **_: object,
    ) -> Town:
        rng = np.random.default_rng(seed)
        places = [shifted(HERE, 12.0 * n, 5.0) for n in range(references)]
        for part in ("references", "queries"):
            (to / part).mkdir(parents=True, exist_ok=True)
        seen = [np.kron(rng.integers(0, 255, (6, 8, 3)), np.ones((6, 6, 1))).astype(np.uint8) for _ in places]
        known = [to / "references" / f"ref_{n}.jpg" for n in range(references)]
        asked = [to / "queries" / name.format(n) for n in range(queries)]
        for n, path in enumerate(known):
            save_jpeg(seen[n], path, where=places[n], heading=None if n else 90.0)
        for n, path in enumerate(asked):
            save_jpeg(seen[n % references], path, quality=70)
        truth = {path.name: shifted(places[n % references], 2.0, 0.0) for n, path in enumerate(asked)}
        conditions = {path.name: ("night", "fog")[n % 2] for n, path in enumerate(asked)}
        corners = [shifted(HERE, *corner) for corner in ((0, 10), (8, 10), (8, 20), (0, 20))]
        return Town(tuple(known), tuple(asked), truth, conditions, (tuple(places),), (tuple(corners),))

    return paint


def judged(path: Path, off: float | None, condition: str = "night", matches: tuple[Match, ...] = ()) -> Judged:
    """An answer `off` metres north of the truth, or an unknown one."""
    place = None if off is None else Place(shifted(HERE, off, 0.0), 26.0, 0.5, 2)
    return Judged(Answer(path, place, list(matches)), HERE, condition)


@pytest.fixture
def outcome(tmp_path: Path, paint: Paint) -> Result:
    """A result with given errors in metres, by condition."""

    def outcome(
        errors: dict[str, list[float | None]] | None = None,
        *,
        name: str = "query_{}.jpg",
        model: str = "fake",
    ) -> DemoResult:
        errors = {"night": [3.0, None], "fog": [80.0]} if errors is None else errors
        flat = [(condition, error) for condition, listed in errors.items() for error in listed]
        town = paint(tmp_path / "town", queries=len(flat), name=name)
        known = [
            Match(Photo(path, shifted(HERE, 30.0 * n, 0.0)), 0.9 - n / 10, n) for n, path in enumerate(town.references)
        ]
        answers = [
            judged(path, error, condition, tuple(known))
            for path, (condition, error) in zip(town.queries, flat, strict=True)
        ]
        return DemoResult(
            town,
            tuple(answers),
            model,
            "fake-1234",
            20,
            4.0,
            7,
            tmp_path / "town.html",
            tmp_path / "town.index",
        )

    return outcome
