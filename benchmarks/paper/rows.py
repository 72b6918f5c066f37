"""Which models are judged: those given as the paper's own, bare backbones, and the models of a folder of runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.paper.figures import DEPTH, SIDE, WIDTH, Claim, claim, first
from salad.ablation.grids import GRIDS
from salad.ablation.run_result import read_result
from salad.errors import BenchmarkError, WeightsError
from salad.models.hub import ZOO

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike

FULL = "dinov2-salad"


@dataclass(frozen=True, slots=True)
class Row:
    """A model to judge.

    Attributes:
        name: Names it on the command line and in files.
        claim: What the paper says of it.
        spec: What to load.
        trained: How, where a run says.
        given: Whether it is a file that somebody says is the paper's own.
    """

    name: str
    claim: Claim
    spec: str
    trained: str = ""
    given: bool = False


def rows(
    sizes: Mapping[str, str | None], backbones: Sequence[str], runs: Sequence[Path], only: Sequence[str]
) -> list[Row]:
    """The models asked for.

    Args:
        sizes: What to load as `full`, `medium` and `small`, where anything.
        backbones: What to load without an aggregator; the paper has no figure of that.
        runs: Folders that `salad compare` wrote.
        only: Names of rows, where not all.

    Raises:
        BenchmarkError: If two have one name, `only` names none, or a folder holds no run.
        ModelError: If what a run says of itself cannot be read.
        WeightsError: If a model is not there.
    """
    found = [_sized(name, spec) for name, spec in sizes.items() if spec is not None]
    for spec in backbones:
        name = spec if spec in ZOO else Path(spec).stem
        found.append(Row(name, Claim(f"{name} as it is", {}), spec))  # the paper has no figure of a bare backbone
    found += [row for folder in runs for row in _trained(folder)]
    names = [row.name for row in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise BenchmarkError(f"two models are called {twice!r}: give each once")
    unknown = next((name for name in only if name not in names), None)
    if unknown is not None:
        raise BenchmarkError(f"--only {unknown}: there is no such row; there are {', '.join(names)}")
    found = [row for row in found if not only or row.name in only]
    absent = next((row.spec for row in found if row.spec not in ZOO and not Path(row.spec).exists()), None)
    if absent is not None:
        raise WeightsError(f"there is no model {absent}: give a file, a folder, or one of {', '.join(ZOO)}")
    return found


def check_given(row: Row, model: DescriberLike) -> None:
    """Refuse now, not after a night of describing, a file that is not the model it was given as.

    Raises:
        WeightsError: If it is another model.
    """
    wrong = list(unlike(row.claim, model))
    if wrong:
        raise WeightsError(
            f"{row.spec} was given as the paper's {row.name} model, but is another ({'; '.join(wrong)}): "
            "give the file of that model"
        )


def unlike(paper: Claim, model: DescriberLike) -> Iterator[str]:
    """Why a model is not the paper's, as far as can be seen of it; nothing where the paper has no figure."""
    if not paper.figures:
        return
    if paper.dim is not None and model.dim != paper.dim:
        yield f"{model.dim:,} numbers, the paper's has {paper.dim:,}"
    if {model.preprocessing.height, model.preprocessing.width} != {SIDE}:
        yield f"photos of another size than the paper's {SIDE} x {SIDE}"
    made: Any = getattr(model, "config", None)  # what has no configuration tells nothing
    if made is None:
        return
    if (getattr(made.backbone, "width", 0), getattr(made.backbone, "depth", 0)) != (WIDTH, DEPTH):
        yield "another backbone than the paper's DINOv2 ViT-B/14"
    if made.aggregator.kind == "salad" and made.aggregator.linear is not None:
        yield "a last linear layer, which the paper's has not"


def _sized(name: str, spec: str) -> Row:
    """One of the paper's three models.

    Raises:
        WeightsError: If it is a name of the zoo that means another model.
    """
    if spec in ZOO and not (name == "full" and spec == FULL):
        raise WeightsError(
            f"{spec} is not the paper's {name} model: give a file or a folder with --{name}"
            + (f", or {FULL}" if name == "full" else "")
        )
    return Row(name, first(name), spec, given=spec not in ZOO)


def _trained(runs: Path) -> list[Row]:
    """The models of a folder of runs: `<row>/seed<k>/model`, of one grid or below a folder for each."""
    found = []
    for grid, of_grid in GRIDS.items():
        for each in of_grid:
            for folder in (runs / each.name, runs / grid / each.name):
                for run in sorted(model.parent for model in folder.glob("seed*/model")):
                    said = claim(each)
                    called = replace(said, title=f"{said.title}, {run.name} of {grid}")
                    name = f"{grid}-{each.name}-{run.name}"
                    found.append(Row(name, called, str(run / "model"), _training_of(run)))
    if not found:
        raise BenchmarkError(
            f"{runs} holds no model of a run: give a folder that salad compare wrote, with <row>/seed<k>/model"
        )
    return found


def _training_of(run: Path) -> str:
    """How a run's model was trained, in a few words; nothing where it has come to no result."""
    result = read_result(run)
    if result is None:
        return ""
    recipe = result.preset["recipe"]
    steps = recipe["head_steps"] + recipe["tune_steps"]
    return f"{steps:,} steps, {result.data['photos']:,} photos, from {result.start['name']}"
