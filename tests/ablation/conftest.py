"""Three models of a comparison; and the small places, models and recipe that tests of training share."""

from __future__ import annotations

import pytest

from salad.ablation.comparison import BenchmarkColumn, ModelLine
from salad.ablation.grids import PaperFigure
from tiny_runs import *  # noqa: F403  # fixtures are found by being here


@pytest.fixture(scope="session")
def three_models() -> tuple[ModelLine, ...]:
    """Of two seeds each: the best one, one whose name must be escaped, and one measured on a single set."""
    town, street = BenchmarkColumn("town", "frames ±1"), BenchmarkColumn("street", "radius 25 m")
    return (
        ModelLine(
            "SALAD",
            {town: {1: [80.0, 82.0], 5: [90.0, 92.0]}, street: {1: [40.0, 41.0]}},
            {"msls-val-740": PaperFigure("msls-val-740", 92.2)},
            2,
            {"trained parameters": 123456.0, "ms a photo": 12.34},
        ),
        ModelLine(
            "GeM | <b>",
            {town: {1: [60.0, 61.0]}, street: {1: [50.0, 51.0]}},
            {"msls-val-740": PaperFigure("msls-val-740", 85.4)},
            2,
            {"trained parameters": 1.0},
        ),
        ModelLine(
            "CosPlace",
            {town: {1: [55.0, 75.0]}},
            {"msls-val-740": PaperFigure("msls-val-740", 87.4, "on another backbone")},
            2,
        ),
    )
