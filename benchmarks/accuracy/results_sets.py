"""What every model reaches on every evaluation set, as a part of a page: recall with intervals."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

KS = ("1", "5", "10")
NAMES = {
    "hog": "HOG, no learning at all",
    "salad-lite-untrained": "untrained trunk, GeM",
    "salad-lite-untrained-average": "untrained trunk, mean of its tokens",
    "salad-lite-untrained-grid": "untrained trunk, 4 x 4 grid of tokens",
    "salad-lite-untrained-vlad": "untrained trunk, VLAD (vocabulary from the training photos)",
    "salad-lite": "**salad-lite**",
    "salad-lite, plain": "the same, scores not centred",
    "salad-lite-route": "**salad-lite-route**",
    "salad-lite-route, plain": "the same, scores not centred",
    "salad-vits": "**salad-vits**",
    "salad-vits, plain": "the same, scores not centred",
}
UNITS = {"block": "blocks of neighbouring frames", "group": "groups of queries", "query": "queries"}
HEAD = """## What ships, on every set

One descriptor a photo, exact search, no re-ranking; scores leave out what all references have in common
([method](method.md#scores)) where the model is calibrated for that, as those that ship are, and is not asked plainly.
Beside these stand descriptors of the same backbone that nothing was trained for, and HOG as a floor. In brackets: 95 %
intervals by bootstrap; frames of one drive are not independent, so whole stretches of it are drawn. Two rows whose
intervals overlap may still differ for certain: `salad compare A.json B.json` draws the same queries for both.
"""

Figure = Mapping[str, Any]


def section(figures: Path) -> str:
    """The part of the page; the last figure of a model on a set counts.

    Raises:
        ValueError: a line is not what `recall.py --json` writes.
    """
    lines = [json.loads(line) for line in figures.read_text(encoding="utf-8").splitlines() if line.strip()]
    last: dict[tuple[str, str], Figure] = {(one["set"], one["model"]): one for one in lines}
    parts = [HEAD]
    for name in dict.fromkeys(one["set"] for one in lines):
        parts.append(_table([one for (there, _), one in last.items() if there == name]))
    models = {one["model"]: one["fingerprint"] for one in lines}
    prints = "; ".join(f"{name} `{fingerprint}`" for name, fingerprint in models.items())
    dates = sorted({one["date"] for one in last.values()})
    parts.append(
        f"`python -m benchmarks.accuracy.recall --json {figures.name}`, {lines[-1]['machine']}, "
        f"seed {lines[-1]['seed']}, {' to '.join(dict.fromkeys((dates[0], dates[-1])))}. Fingerprints: {prints}.\n"
    )
    return "\n".join(parts)


def _table(rows: Sequence[Figure]) -> str:
    first = rows[0]
    drawn = first["drawn"]
    ordered = sorted(
        rows, key=lambda one: list(NAMES).index(one["model"]) if one["model"] in NAMES else len(NAMES)
    )
    lines = [
        f"### {first['set']}: {first['protocol']}, {first['viewpoint']} viewpoint\n",
        f"{first['queries']:,} queries, {first['references']:,} references, {first['unanswerable']} unanswerable; "
        f"drawn by {drawn['units']:,} {UNITS[drawn['by']]}.\n",
        "| | " + " | ".join(f"R@{k}" for k in KS) + " |",
        "|---" * (len(KS) + 1) + "|",
    ]
    for one in ordered:
        cells = [_cell(one["recall"][k], one["intervals"][k]) for k in KS]
        lines.append(f"| {NAMES.get(one['model'], one['model'])} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(percent: float, interval: Sequence[float]) -> str:
    low, high = interval
    return f"{percent:.1f} ({low:.0f} to {high:.0f})"
