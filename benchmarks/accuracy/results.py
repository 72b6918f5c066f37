"""The grids on the photos beside the checkout, and the page of what came of them and of the models that ship.

    python -m benchmarks.accuracy.results run [GRID ...] [--sets NAME,...] [-- OPTIONS OF salad compare]
    python -m benchmarks.accuracy.recall --json runs/models.jsonl
    python -m benchmarks.accuracy.results write [--from runs/grids] [--models runs/models.jsonl]

`run` is `salad compare` with every evaluation set that is there, one folder a grid; interrupt it as you like, it
goes on. `write` makes the page and its pictures from the folders alone: no figure on it is typed by hand. A grid of
which there is no result here keeps what the page says of it.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.recall import SETS as EVERY
from benchmarks.options import EVAL, ROOT, RUNS, TRAIN, benchmark_parser
from salad.ablation.comparison_tables import write_tables
from salad.ablation.grids import GRIDS, grid_rows
from salad.errors import SaladError

COMMAND = "command.json"
SETS = [each for each in EVERY if each.name != "toy"]  # by eye, and too small to tell rows apart
HEADINGS = {
    "aggregators": "One backbone, other aggregators",
    "blocks": "How much of the backbone is trained",
    "parts": "SALAD with parts left out or exchanged",
    "sizes": "Smaller and larger heads",
}
HEAD = """# Results

Written by `python -m benchmarks.accuracy.results write` from what was measured; do not edit it by hand.
"""
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
SHIPPED_HEAD = """## What ships, on every set

One descriptor a photo, exact search, no re-ranking; scores leave out what all references have in common
([method](method.md#scores)) where the model is calibrated for that, as those that ship are, and is not asked plainly.
Beside these stand descriptors of the same backbone that nothing was trained for, and HOG as a floor. In brackets: 95 %
intervals by bootstrap; frames of one drive are not independent, so whole stretches of it are drawn. Two rows whose
intervals overlap may still differ for certain: `salad compare A.json B.json` draws the same queries for both.
"""
TERMS = """## On equal terms

Every row of a table is trained with the same budget, the same photos and the same seeds, and the best weights on
places held out of the training photos are kept; no evaluation photo chooses anything. The budget is small and stands
under each table, so these are small models early in their training; what stands beside them in the columns `paper:` was
measured elsewhere, on other data, with other backbones. Read the order of rows, and with the spread in mind: sets of 60
to 210 queries (nordland64: 1,479) move by points of their own. Viewpoint changes in gardens-point, essex and corridor;
in sfxl-30 and nordland64 the camera looks the same way again.
"""


def command(grid: str, to: Path, sets: Sequence[str], more: Sequence[str]) -> list[str]:
    """`salad compare` with those of the sets that are there."""
    options = ["compare", "--grid", grid, "--to", str(to), "--data", str(TRAIN)]
    for each in SETS:
        if each.name not in sets:
            continue
        if not (EVAL / each.name).is_dir():
            print(f"{each.name}: not at {EVAL}, passed over", file=sys.stderr)
            continue
        options += ["--benchmark", *map(str, each.options(EVAL))]
    return [*options, *more]


def run(grids: Sequence[str], to: Path, sets: Sequence[str], more: Sequence[str]) -> None:
    """Run each grid; the command is kept beside its results."""
    for grid in grids:
        folder = to / grid
        options = command(grid, folder, sets, more)
        folder.mkdir(parents=True, exist_ok=True)
        # As it would be typed in the checkout.
        shown = [option.replace(f"{ROOT}/", "").replace(f"{ROOT.parent}/", "../") for option in options]
        (folder / COMMAND).write_text(json.dumps(shown) + "\n", encoding="utf-8")
        code = subprocess.run([sys.executable, "-m", "salad", *options], check=False).returncode
        if code:
            raise SystemExit(code)


def page(grids: Sequence[str], runs: Path, models: Path, pictures: Path, *, before: str = "") -> str:
    """The page's text, where it was `before`; each grid's picture goes into `pictures`."""
    parts, kept = [HEAD], parts_of(before)
    if models.is_file():
        parts.append(shipped_section(models))
    parts.append(TERMS)
    for grid in grids:
        parts.append(f"### {HEADINGS[grid]}\n")
        folder = runs / grid
        try:
            table = write_tables(folder, grid, grid_rows(grid))
        except SaladError as error:
            print(f"{grid}: {error}", file=sys.stderr)
            parts.append(kept.get(HEADINGS[grid], "There is no result of this grid yet.\n"))
            continue
        picture = f"results-{grid}.svg"
        shutil.copy(folder / f"{grid}.svg", pictures / picture)
        parts.append(f"![R@1 of every row, ours and the paper's]({picture})\n")
        parts.append(f"{table}\n")
        parts += _repeated(folder, grid)
    return "\n".join(parts)


def parts_of(page: str) -> dict[str, str]:
    """What stands under each heading of the third order."""
    parts = (part.partition("\n") for part in re.split(r"^### ", page, flags=re.MULTILINE)[1:])
    return {heading: re.split(r"^## ", body, flags=re.MULTILINE)[0].strip("\n") + "\n" for heading, _, body in parts}


def _repeated(folder: Path, grid: str) -> list[str]:
    """What to type to have the same, as far as it is known."""
    known = folder / COMMAND
    if not known.is_file():
        return []
    options = shlex.join(["salad", *json.loads(known.read_text(encoding="utf-8"))])
    options = options.replace(" --benchmark", " \\\n  --benchmark")
    return [f"`python -m benchmarks.accuracy.results run {grid}`, which is\n\n```\n{options}\n```\n"]


def shipped_section(figures: Path) -> str:
    """The part of the page; the last figure of a model on a set counts.

    Raises:
        ValueError: If a line is not what `recall.py --json` writes.
    """
    lines = [json.loads(line) for line in figures.read_text(encoding="utf-8").splitlines() if line.strip()]
    last: dict[tuple[str, str], Mapping[str, Any]] = {(one["set"], one["model"]): one for one in lines}
    parts = [SHIPPED_HEAD]
    for name in dict.fromkeys(one["set"] for one in lines):
        parts.append(_set_table([one for (there, _), one in last.items() if there == name]))
    models = {one["model"]: one["fingerprint"] for one in lines}
    prints = "; ".join(f"{name} `{fingerprint}`" for name, fingerprint in models.items())
    dates = sorted({one["date"] for one in last.values()})
    parts.append(
        f"`python -m benchmarks.accuracy.recall --json {figures.name}`, {lines[-1]['machine']}, "
        f"seed {lines[-1]['seed']}, {' to '.join(dict.fromkeys((dates[0], dates[-1])))}. Fingerprints: {prints}.\n"
    )
    return "\n".join(parts)


def _set_table(rows: Sequence[Mapping[str, Any]]) -> str:
    first = rows[0]
    drawn = first["drawn"]
    ordered = sorted(rows, key=lambda one: list(NAMES).index(one["model"]) if one["model"] in NAMES else len(NAMES))
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


def main() -> None:
    parser = benchmark_parser(__doc__)
    parser.add_argument("what", choices=("run", "write"))
    parser.add_argument("grids", nargs="*", metavar="GRID", help=f"of {', '.join(GRIDS)}; all by default")
    every = [each.name for each in SETS]
    parser.add_argument("--sets", default=",".join(every), help="with commas; all by default")
    parser.add_argument("--to", "--from", dest="runs", type=Path, default=RUNS / "grids")
    parser.add_argument("--models", type=Path, default=RUNS / "models.jsonl")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "results.md")
    before, more = sys.argv[1:], []
    if "--" in before:
        before, more = before[: before.index("--")], before[before.index("--") + 1 :]
    asked = parser.parse_args(before)
    grids = asked.grids or list(GRIDS)
    unknown = set(grids) - set(GRIDS)
    if unknown:
        parser.error(f"there is no grid {unknown.pop()!r}: choose among {', '.join(GRIDS)}")
    if asked.what == "write" and asked.grids:
        parser.error(f"write makes the whole page: leave {' '.join(asked.grids)} away")
    sets = asked.sets.split(",")
    if set(sets) - set(every):
        parser.error(f"--sets {asked.sets}: choose among {', '.join(every)}")
    if asked.what == "run":
        run(grids, asked.runs, sets, more)
    else:
        before = asked.page.read_text(encoding="utf-8") if asked.page.is_file() else ""
        text = page(list(GRIDS), asked.runs, asked.models, asked.page.parent, before=before)
        asked.page.write_text(text, encoding="utf-8")
        print(asked.page)


if __name__ == "__main__":
    main()
