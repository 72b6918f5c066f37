"""What is written down under a name, as JSON: options, settings, weights, keys. `test_names.py` holds it.

Everything here lies in other people's files and scripts, so what is recorded in `recorded/` is frozen: nothing of it
may go or change. More may come; then record it too, by hand, where others will lean on it.

    cd tests && PYTHONPATH=../src:. python -m pins.facts      # writes only what has no file yet
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from pins import where
from pins.where import RECORDED, ModelConfig, Preprocessing, Recipe, salad_says, shape, street

SHIPPED = {
    "salad-lite": "ea968928572f4e59",
    "salad-vits": "34558a0e8c15db73",
    "salad-lite-route": "c9b2406dab760798",
}


# --- options -------------------------------------------------------------------------------


def commands() -> dict[str, dict[str, str]]:
    """For each command its options as `--help` shows them, with what they are where they are not given."""
    return dict(_commands())


def _commands(*name: str) -> Iterator[tuple[str, dict[str, str]]]:
    shown = salad_says(*name, "--help").out
    below = re.match(r"usage: salad[a-z -]*? \[-h\]\s+\{([a-z,\s-]+)\}", shown)
    if below:
        for command in re.split(r",\s*", below[1]):
            yield from _commands(*name, command)
        return
    entries: dict[str, str] = {}
    for line in re.findall(r"^[│ ] (.*?) *│?$", shown, re.MULTILINE):  # the box is drawn where it can be
        if found := re.match(r"(--?[a-z].*?|[A-Z]+)(  .*)?$", line):
            entries[option := found[1]] = found[2] or ""
        elif entries and line.startswith("  "):
            entries[option] += " " + line.strip()
    yield " ".join(name), {option: _default(told) for option, told in entries.items()}


def _default(told: str) -> str:
    found = re.search(r"\((?:default: )?([^()]*)\)$", told)
    return found[1] if found else ""


# --- settings ------------------------------------------------------------------------------


def settings() -> dict[str, Any]:
    """Every setting of a model and of a run, with its default as JSON would hold it."""
    kinds: dict[str, Any] = {f"aggregator {kind}": where.aggregator_kind(kind) for kind in where.AGGREGATOR_KINDS}
    kinds |= {f"backbone {kind}": one for kind, one in where.BACKBONE_KINDS.items()}
    kinds |= {
        "model": ModelConfig,
        "preprocessing": Preprocessing,
        "calibration": where.Calibration,
        "recipe": Recipe,
    }
    return {name: {field.name: _plain(field) for field in dataclasses.fields(kind)} for name, kind in kinds.items()}


def _plain(field: dataclasses.Field[Any]) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    return "required" if field.default_factory is dataclasses.MISSING else "made"


def written() -> dict[str, Any]:
    """How each named aggregator is written down, wide and narrow; a setting that came later only where it is set."""
    of = {f"{name} {width}": made for width in (120, 768) for name, made in where.compared_aggregators(width).items()}
    of["later"] = where.SaladConfig(120, dustbin_share=0.35)
    by = where.Calibration(centred=True)
    return {name: ModelConfig(name, where.LiteConfig(), one, calibration=by).as_dict() for name, one in of.items()}


def presets() -> dict[str, Any]:
    """What `salad train` makes without another word."""
    return {
        name: {"start": one.start, "model": one.model.as_dict(), "recipe": dataclasses.asdict(one.recipe)}
        for name, one in where.PRESETS.items()
    }


# --- models --------------------------------------------------------------------------------


def models() -> dict[str, Any]:
    """The configurations that ship, and the names, shapes and types of their weights."""
    told: dict[str, Any] = {}
    for name in SHIPPED:
        config, held = where.shipped(name)
        weights = {key: f"{list(one.shape)} {one.dtype}" for key, one in sorted(held.items())}
        digest = hashlib.sha256(json.dumps(weights).encode()).hexdigest()
        told[name] = {
            "config": config,
            "count": len(weights),
            "weights": weights if name == "salad-lite" else digest,
        }
    return told


def zoo() -> dict[str, Any]:
    """The models of the zoo and the protocols of benchmarks, by name."""
    lists = {name: json.loads(salad_says(name, "list", "--format", "json").out) for name in ("weights", "datasets")}
    facts = ("references", "queries", "right when", "unanswerable", "layouts")
    return {
        "weights": {one["name"]: one["licence"] for one in lists["weights"]},
        "datasets": {one["protocol"]: {fact: one[fact] for fact in facts} for one in lists["datasets"]},
        "keys": {name: shape(rows) for name, rows in lists.items()},
    }


# --- what commands write -------------------------------------------------------------------


def outputs() -> dict[str, Any]:
    """The keys and types of all JSON that the commands write, and the columns of all tables."""
    with tempfile.TemporaryDirectory() as home:
        return _outputs(Path(home))


def _outputs(home: Path) -> dict[str, Any]:
    table, places = draw_streets(home)
    index, result = home / "i", home / "result.json"
    put = {name: home / f"{name}.csv" for name in ("evaluate", "places")}
    _run("index", home / "references", "--to", index, "--table", table)
    asked = (home / "queries", "--index", index, "-k", 3, "--min-confidence", 0, "--format")
    folders = ("--references", home / "references", "--queries", home / "queries")
    judge = ("evaluate", *folders, "--radius", 25, "--table", table, "--leaks", "--format", "json")
    cells = ("--table", places, "--apart", 0, "--cell", 50, "--turn", 360, "--format", "json")
    found = ("places", home / "references", "--to", put["places"], *cells)
    told = {
        "info": shape(json.loads(_run("info", index, "--format", "json"))),
        "locate json": shape(json.loads(_run("locate", *asked, "json"))),
        "locate geojson": shape(json.loads(_run("locate", *asked, "geojson"))),
        "locate csv": _columns(_run("locate", *asked, "csv")),
        "evaluate json": shape(json.loads(_run(*judge, "--save", result, "--csv", put["evaluate"]))),
        "evaluate --save": shape(json.loads(result.read_bytes())),
        "evaluate --csv": _columns(put["evaluate"].read_text(encoding="utf-8")),
        "places json": shape(json.loads(_run(*found))),
        "places csv": _columns(put["places"].read_text(encoding="utf-8")),
    }
    for form in ("csv", "geojson"):
        _run("export", index, "--to", home / form, "--format", form)
        told[f"export {form}"] = sorted(file.name for file in (home / form).iterdir())
        told[f"export {form} model"] = shape(json.loads((home / form / "model.json").read_bytes()))
    return told


def draw_streets(home: Path) -> tuple[Path, Path]:
    """Eight references and three queries in `home`, and tables of where they are: apart, and in two places."""
    tables = []
    for name, apart in (("apart", 100), ("places", 1)):
        tables.append(home / f"{name}.csv")
        lines = ["path,lat,lon,heading,time\n"]
        for side, count in (("references", 8), ("queries", 3)):
            for number in range(count):
                lat = 48.1 + (number * apart + 300 * (number // 4)) / 111_000
                lines.append(f"{side}/{number}.png,{lat:.6f},11.5,{10 * number},2024-05-0{number + 1}T12:00:00\n")
        tables[-1].write_text("".join(lines), encoding="utf-8")
    for side, seed, count in (("references", 0, 8), ("queries", 1, 3)):
        (home / side).mkdir()
        for number in range(count):
            copied = (side, number) == ("queries", 2)  # a leak, for `evaluate --leaks` to find
            street(number, seed=0 if copied else seed).save(home / side / f"{number}.png")
    return tables[0], tables[1]


def _run(*arguments: object) -> str:
    ran = salad_says(*arguments)
    assert ran.code == 0, ran.err
    return ran.out


def _columns(text: str) -> list[str]:
    return next(csv.reader(text.splitlines()))


# --- a run ---------------------------------------------------------------------------------

STOPPED = Path(__file__).with_name("stopped")
"""A run of four steps that was killed after two, with the photos it learnt from no longer there."""
TINY = where.Preset(
    ModelConfig(
        "tiny",
        where.LiteConfig(blocks=1),
        where.SaladConfig(16, clusters=4, cluster_dim=3, scene_dim=4, hidden=8, dustbin_share=0.35),
        Preprocessing(32, 32),
    ),
    start="",
    recipe=Recipe(
        2,
        2,
        places=2,
        views=2,
        tuned_blocks=1,
        held_out=0.34,
        measure_every=1,
        save_every=1,
        precision="32-true",
    ),
)


def teach(to: Path, *, photos: Path, stop_after: int | None = None, **options: Any) -> None:
    """Teach the tiny model six drawn places; kill it after so many steps."""

    def progress(done: int, _: int | None) -> None:
        if done == stop_after:
            raise KeyboardInterrupt

    for place in range(6):
        (photos / f"place {place}").mkdir(parents=True)
        for number in range(4):
            street(place, seed=number, side=36).save(photos / f"place {place}" / f"{number}.png")
    quiet: dict[str, Any] = {"accelerator": "cpu", "say": lambda _: None, "progress": progress}
    with suppress(KeyboardInterrupt):
        where.train(TINY, where.find_places(photos), to=to, **quiet | options)


def run() -> dict[str, Any]:
    """What a run's folder holds: the keys of its files, and what decides whether it may be gone on with."""
    with tempfile.TemporaryDirectory() as home:
        to = Path(home, "run")
        teach(to, photos=Path(home, "set"))
        saved = torch.load(to / "last.ckpt", weights_only=True)
        lines = (to / "log.jsonl").read_text(encoding="utf-8").splitlines()
        config = json.loads((to / "config.json").read_bytes())
        return {
            "files": sorted(str(file.relative_to(to)) for file in to.rglob("*") if file.is_file()),
            "config.json": shape(config | {"versions": {}}),
            "log.jsonl": shape([json.loads(line) for line in lines]),
            "last.ckpt": list(saved),
            "identity": {key: saved[key] for key in ("recipe", "architecture", "data", "start", "judge")},
            "model/config.json": json.loads((to / "model" / "config.json").read_bytes()),
        }


FACTS: dict[str, Callable[[], Any]] = {
    one.__name__: one for one in (commands, settings, written, presets, models, zoo, outputs, run)
}

if __name__ == "__main__":
    for name, fact in FACTS.items():
        path = RECORDED / f"{name}.json"
        if not path.exists():
            text = json.dumps(fact(), indent=1, ensure_ascii=False)
            path.write_text(text + "\n", encoding="utf-8")
    if not STOPPED.exists():
        with tempfile.TemporaryDirectory() as photos:
            teach(STOPPED, photos=Path(photos, "set"), stop_after=2)
