"""The paper's rows run on tiny sets of the published layouts, with a model that knows no place."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from benchmarks.paper import figures, rows, sets
from benchmarks.paper import reproduce as reproduce_paper
from benchmarks.paper.page import Figure, Judged, Report
from salad.ablation.grids import GRIDS
from salad.datasets.protocols import PROTOCOLS, read
from salad.errors import BenchmarkError, FetchError
from salad.evaluation import descriptors
from salad.evaluation.evaluate_benchmark import evaluate
from salad.evaluation.result import read_result, write_result
from salad.models.fake import FakeDescriber
from salad.models.hub import path_of
from salad.network.aggregator_config import SaladConfig
from salad.network.config import Preprocessing, ViTConfig

ROOT = Path(__file__).resolve().parents[2]
PAPERS = Preprocessing()
COUNTS = {"msls-val-740": (6, 3), "nordland-1f": (21, 3), "pitts250k-test": (4, 4), "sped": (5, 5)}


@pytest.fixture(scope="module")
def fakes() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fakes", ROOT / "tests" / "datasets" / "fakes.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def paint(folder: Path, numbers: Callable[[str], int]) -> None:
    """A photo in place of every empty file: coloured squares that no other number has."""
    for path in folder.rglob("*.jpg"):
        squares = np.random.default_rng(numbers(path.name)).integers(0, 256, (4, 4, 3), dtype=np.uint8)
        Image.fromarray(np.kron(squares, np.ones((6, 6, 1), dtype=np.uint8))).save(path, quality=95)


def number_in(name: str) -> int:
    return int(re.findall(r"\d+", name)[-1])


@pytest.fixture
def data(tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Path:
    """All four sets; every query looks as one right reference does, but for MSLS', which are like wrong ones."""
    for name, (references, queries) in COUNTS.items():
        monkeypatch.setitem(PROTOCOLS, name, replace(PROTOCOLS[name], references=references, queries=queries))
    root = tmp_path / "sets"
    fakes.msls(root / "MSLS", {"cph": (fakes.line(4, 90.0), [1.0, 91.0]), "sf": (fakes.line(2, 90.0), [1.0])})
    paint(root / "MSLS" / "train_val", lambda name: number_in(name) + 40 * ("query" in name))
    fakes.numbered(root / "Nordland", range(21), range(3))
    paint(root / "Nordland" / "ref", number_in)
    paint(root / "Nordland" / "query", lambda name: 10 * number_in(name))
    fakes.dbstruct(root / "from NetVLAD", "pitts250k_test", fakes.line(4, 100.0), fakes.line(4, 100.0))
    paint(root / "from NetVLAD", lambda name: 2 * number_in(name.split("_")[0]) + number_in(name))
    fakes.numbered(root / "SPED", range(5), range(5))
    paint(root / "SPED", number_in)
    return root


@dataclass(frozen=True)
class Counting(FakeDescriber):
    """Counts what it describes; stops like Ctrl-C after so many photos."""

    seen: list[int] = field(default_factory=list)
    stop: int | None = None

    def describe(self, photos: Sequence[Any], *, batch_size: int = 16) -> Any:
        if self.stop is not None and len(self.seen) >= self.stop:
            raise KeyboardInterrupt
        self.seen.extend(range(len(photos)))
        return super().describe(photos, batch_size=batch_size)


def model(dim: int = 8448, **settings: Any) -> Counting:
    return Counting(dim=dim, preprocessing=PAPERS, **settings)


@dataclass(frozen=True)
class Ran:
    code: int
    page: str
    figures: list[dict[str, Any]]
    missing: list[str]
    out: str
    err: str

    def of(self, name: str, protocol: str) -> dict[str, Any]:
        (found,) = (one for one in self.figures if (one["name"], one["result"]["protocol"]) == (name, protocol))
        return found


Run = Callable[..., Ran]


@pytest.fixture
def reproduce(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """`reproduce("--sped", folder, made=model())`: every model is that one, or what `made` makes of its name."""

    def run(*arguments: object, made: Any = None) -> Ran:
        def load(spec: str, **_: object) -> Any:
            return made(spec) if callable(made) else made or model()

        to = tmp_path / "to"
        capsys.readouterr()
        code = reproduce_paper.main([*map(str, arguments), "--to", str(to)], load=load)
        written = (to / "reproduction.json").is_file()
        told = json.loads((to / "reproduction.json").read_text()) if written else {"figures": [], "missing": []}
        page = (to / "reproduction.md").read_text() if written else ""
        return Ran(code, page, told["figures"], told["missing"], *capsys.readouterr())

    return run


def section(page: str, protocol: str) -> list[str]:
    """The lines of a protocol's table, heads and rule left out."""
    text = page.split(f"## {protocol}\n")[1].split("\n## ")[0]
    return [line for line in text.splitlines() if line.startswith("|")][2:]


class TestFigures:
    def test_they_are_the_specifications(self, shared: Path) -> None:
        text = (shared / "spec" / "method.md").read_text()
        columns = ("", "msls-val-740", "nordland-1f", "pitts250k-test", "sped")  # the first is the challenge
        for name in figures.METHODS:
            claim = figures.first(name)
            cells = re.search(rf"\| {claim.title} \| (\d+) \|(.*)\|", text)
            assert cells is not None
            assert claim.dim in (None, int(cells[1]))
            found = {
                protocol: dict(zip((1, 5), map(float, cell.split("/")), strict=True))
                for protocol, cell in zip(columns, cells[2].split("|"), strict=True)
                if protocol
            }
            assert claim.figures == found
        assert {name for name in figures.METHODS if figures.first(name).dim} == {"small", "medium", "full"}

    def test_every_row_of_the_grids_has_named_protocols_and_its_size(self) -> None:
        claims = {(grid, row.name): figures.claim(row) for grid in GRIDS for row in GRIDS[grid]}
        assert {protocol for one in claims.values() for protocol in one.figures} == set(COUNTS)
        dims = {name: one.dim for (_, name), one in claims.items()}
        assert (dims["netvlad"], dims["vlad"], dims["blocks-0"], dims["no-dustbin"]) == (
            24576,
            49152,
            8448,
            8448,
        )
        assert dims["gem"] is None
        assert dims["no-scene"] is None
        assert dims["many-clusters"] is None  # ours alone
        assert claims["aggregators", "cosplace"].aside


class TestPage:
    @given(ours=st.integers(0, 1000), paper=st.integers(0, 1000), k=st.sampled_from([1, 5]))
    def test_over_a_point_is_as_printed(self, ours: int, paper: int, k: int) -> None:
        one = figure("sped", ours / 10, {"sped": {k: paper / 10}})
        assert one.over(k) == (abs(ours - paper) > 10)
        assert one.difference(k) == pytest.approx((ours - paper) / 10)
        assert not one.over(6 - k)
        assert one.difference(6 - k) is None

    @given(st.lists(st.sampled_from([*COUNTS, "msls-val-11k", "sped (5 references, 5 queries)"]), min_size=1))
    def test_no_table_holds_two_protocols(self, protocols: list[str]) -> None:
        claimed = {"sped": {1: 92.1}, "msls-val-740": {1: 92.2}}
        figures = [figure(name, 50.0, claimed, title=f"{name}/{row}") for row, name in enumerate(protocols)]
        page = Report(figures=figures).markdown()
        for name in set(protocols):
            lines = section(page, name)
            assert [line.split(" |")[0].strip("| ") for line in lines] == [
                one.model.claim.title for one in figures if one.result.protocol == name
            ]
            theirs = {line.split(" | ")[2] for line in lines}
            assert theirs == {f"{claimed[name][1]:.1f}" if name in claimed else "–"}

    def test_what_is_not_the_papers_is_not_compared(self) -> None:
        one = figure("sped", 10.0, {"sped": {1: 92.1}}, unlike=("64 numbers",))
        assert not Report(figures=[one]).over
        text = Report(figures=[one]).markdown()
        assert "92.1\\*" in text
        assert "Not compared: 64 numbers" in text
        assert "Nothing that ran has a figure" in text


def figure(protocol: str, percent: float, claimed: Any, *, title: str = "m", unlike: tuple[str, ...] = ()) -> Figure:
    from salad.evaluation.bootstrap import Interval
    from salad.evaluation.result import Result

    claim = figures.Claim(title, claimed)
    ks = (1, 5)
    result = Result(
        *("b", protocol, 5, 5, 0),
        recall=dict.fromkeys(ks, percent),
        model="m",
        seconds=1.0,
        intervals=dict.fromkeys(ks, Interval(0.0, 100.0)),
    )
    return Figure(Judged(title, claim, "m", 8, "f", (322, 322), unlike=unlike), result)


class TestRun:
    def test_all_four_sets_whatever_their_layouts(self, data: Path, reproduce: Run, tmp_path: Path) -> None:
        ran = reproduce(data)
        assert (ran.code, ran.missing) == (1, [])
        assert {one["name"] for one in ran.figures} == {"full", "dinov2-vitb14"}
        for name, (references, queries) in COUNTS.items():
            one = ran.of("full", name)
            assert (one["result"]["references"], one["result"]["queries"]) == (references, queries)
            assert one["result"]["recall"]["1"] == (100.0 if name != "msls-val-740" else pytest.approx(0, abs=70))
            assert set(one["paper"]) == {"1", "5"}
            assert ran.of("dinov2-vitb14", name)["paper"] == {}
        sped = ran.of("full", "sped")
        assert (sped["paper"], sped["difference"]) == ({"1": 92.1, "5": 96.2}, {"1": 7.9, "5": 3.8})
        assert sped["over"] == [1, 5]
        assert sped["result"]["fingerprint"] == model().fingerprint
        (line,) = (line for line in section(ran.page, "sped") if line.startswith("| SALAD full"))
        assert "| 92.1 | **+7.9** |" in line
        assert ran.page.startswith("# Ours beside the paper's")
        assert ran.page.rstrip() == ran.out.rstrip()
        saved = read_result(tmp_path / "to" / "results" / "full-sped.json")
        assert saved.recall == evaluate(read("sped", data / "SPED"), model()).recall

    def test_machine_date_and_versions_are_told(self, data: Path, reproduce: Run, tmp_path: Path) -> None:
        ran = reproduce("--sped", data / "SPED", "--only", "full")
        told = json.loads((tmp_path / "to" / "reproduction.json").read_text())
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", told["date"])
        for part in (
            told["date"],
            told["machine"],
            "torch " + told["versions"]["torch"],
            model().fingerprint,
        ):
            assert part in ran.page
        assert "arXiv 2311.15937" in told["paper"]

    def test_within_a_point_leaves_with_0(self, data: Path, reproduce: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        claim = figures.Claim("full", {"sped": {1: 99.0, 5: 100.0}}, 8448)
        monkeypatch.setattr(rows, "first", lambda _: claim)
        ran = reproduce("--sped", data / "SPED", "--only", "full")
        assert (ran.code, ran.of("full", "sped")["difference"]) == (0, {"1": 1.0, "5": 0.0})
        assert "2 of 2 figures are within one point" in ran.page

    def test_a_set_that_is_missing_is_told_and_the_others_run(self, data: Path, reproduce: Run) -> None:
        (data / "Nordland").rename(data / "somewhere")
        (data / "SPED" / "query" / "0000004.jpg").unlink()
        ran = reproduce(data, "--only", "full")
        assert {one["result"]["protocol"] for one in ran.figures} == {"msls-val-740", "pitts250k-test"}
        absent, differs = ran.missing
        for part in (
            "nordland-1f",
            "looked for ref/ and query/",
            "nordland_{dbImages,qImages,gt}.npy",
            "nrkbeta.no",
        ):
            assert part in absent
            assert part in ran.err
        assert "expected 5 queries, found 4" in differs
        assert "## Not run" in ran.page

    def test_a_folder_that_is_itself_a_set(self, data: Path, reproduce: Run) -> None:
        assert [one["result"]["protocol"] for one in reproduce(data / "SPED", "--only", "full").figures] == ["sped"]
        with pytest.raises(BenchmarkError, match="cannot be read"):
            sets.find_set("sped", data / "absent")

    def test_a_part_of_a_set_is_its_own_protocol(self, data: Path, reproduce: Run) -> None:
        (data / "SPED" / "query" / "0000004.jpg").unlink()
        ran = reproduce("--any-size", "--sped", data / "SPED", "--only", "full")
        assert ran.code == 0
        (one,) = ran.figures
        assert (one["result"]["protocol"], one["paper"]) == ("sped (5 references, 4 queries)", {})
        assert "Nothing that ran has a figure" in ran.page

    def test_a_model_that_cannot_be_fetched_and_a_photo_that_cannot_be_read(self, data: Path, reproduce: Run) -> None:
        def made(spec: str) -> Any:
            if spec == "dinov2-salad":
                raise FetchError("could not fetch it: no network")
            return model()

        (data / "SPED" / "ref" / "0000001.jpg").write_bytes(b"no photo")
        ran = reproduce(data, made=made)
        assert {one["name"] for one in ran.figures} == {"dinov2-vitb14"}
        assert len(ran.figures) == 3
        assert "no network" in ran.missing[0]
        assert "a figure with holes is no figure" in ran.missing[1]
        assert ran.code == 0

    def test_nothing_that_can_be_run(self, data: Path, reproduce: Run) -> None:
        def made(spec: str) -> Any:
            raise FetchError("could not fetch it: no network")

        ran = reproduce(data, made=made)
        assert (ran.code, ran.figures) == (2, [])
        assert "no model could be run" in ran.err

    def test_an_interrupted_run_goes_on(self, data: Path, reproduce: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(descriptors, "_PHOTOS", 4)
        first, second, third = model(stop=12), model(), model()
        only = (data, "--only", "full", "--batch-size", 4)
        cut = reproduce(*only, made=first)
        assert cut.code == 130
        assert {one["result"]["protocol"] for one in cut.figures} == {"msls-val-740"}  # what there was is written
        assert "goes on where it stopped" in cut.err
        whole = reproduce(*only, made=second)
        assert len(whole.figures) == 4
        assert len(second.seen) > 0
        again = reproduce(*only, made=third)
        assert third.seen == []
        recalls = [[one["result"]["recall"] for one in ran.figures] for ran in (whole, again)]
        assert recalls[0] == recalls[1]
        plain = evaluate(read("nordland-1f", data / "Nordland"), model())
        assert whole.of("full", "nordland-1f")["result"]["recall"] == {str(k): r for k, r in plain.recall.items()}


class TestRows:
    def test_medium_and_small_by_their_files(self, data: Path, reproduce: Run, tmp_path: Path) -> None:
        for name in ("m.ckpt", "s.ckpt"):
            (tmp_path / name).touch()
        sizes = {"dinov2-salad": 8448, "m.ckpt": 2112, "s.ckpt": 544, "dinov2-vitb14": 768}
        ran = reproduce(
            *("--sped", data / "SPED", "--medium", tmp_path / "m.ckpt", "--small", tmp_path / "s.ckpt"),
            made=lambda spec: model(sizes[Path(spec).name]),
        )
        found = {one["name"]: (one["dim"], one["paper"].get("1")) for one in ran.figures}
        assert found == {
            "full": (8448, 92.1),
            "medium": (2112, 89.5),
            "small": (544, 88.5),
            "dinov2-vitb14": (768, None),
        }

    def test_the_models_of_runs(self, data: Path, reproduce: Run, tmp_path: Path) -> None:
        runs = tmp_path / "runs"
        for folder in ("parts/no-dustbin/seed0", "parts/no-dustbin/seed1", "cosplace/seed0", "netvlad/seed3"):
            (runs / folder / "model").mkdir(parents=True)
        told = {
            "format": 1,
            **{key: {} for key in ("parameters", "held_out", "benchmarks", "seconds", "versions", "machine")},
            "row": "no-dustbin",
            "seed": 0,
            "dim": 8448,
            "milliseconds": 1.0,
            "fingerprint": "",
            "finished": "",
            "preset": {"recipe": {"head_steps": 1000, "tune_steps": 3000}},
            "start": {"name": "dinov2_vitb14_pretrain.pth", "sha256": ""},
            "data": {"photos": 530_000},
        }
        (runs / "parts" / "no-dustbin" / "seed0" / "result.json").write_text(json.dumps(told))
        taken = ("--sped", data / "SPED", "--msls-val", data / "MSLS", "--runs", runs)
        ran = reproduce(*taken)
        msls = "msls-val-740"
        assert ran.of("parts-no-dustbin-seed0", msls)["paper"] == {"1": 91.4}
        assert ran.of("parts-no-dustbin-seed1", msls)["difference"]["1"] is not None
        assert ran.of("parts-no-dustbin-seed0", msls)["trained"] == (
            "4,000 steps, 530,000 photos, from dinov2_vitb14_pretrain.pth"
        )
        assert ran.of("parts-no-dustbin-seed0", "sped")["paper"] == {}
        for name, why in (
            ("aggregators-cosplace-seed0", "on a backbone of its own"),
            ("aggregators-netvlad-seed3", "8,448 numbers, the paper's has 24,576"),
        ):
            one = ran.of(name, "sped")
            assert one["difference"] == {"1": None, "5": None}
            assert why in " ".join(one["aside"])
            assert why in ran.page

    def test_a_method_judged_elsewhere(self, data: Path, reproduce: Run, tmp_path: Path) -> None:
        saved = tmp_path / "theirs.json"
        write_result(evaluate(read("sped", data / "SPED"), FakeDescriber(name="their own")), saved)
        ran = reproduce("--result", "eigenplaces", saved)
        (one,) = ran.figures
        assert (one["title"], one["paper"]) == ("EigenPlaces, their own", {"1": 69.9, "5": 82.9})
        assert (one["dim"], one["image"], ran.code) == (None, None, 1)
        assert len(ran.missing) == 4  # no set was named
        write_result(evaluate(read("sped", data / "SPED"), FakeDescriber(), ks=(1,)), saved)
        short = reproduce("--result", "eigenplaces", saved)
        assert (short.code, "has no R@1 and R@5" in short.err) == (2, True)
        other = reproduce("--result", "megaloc", saved)
        assert (other.code, "the paper's first table has netvlad, gem" in other.err) == (2, True)

    def test_what_tells_another_model(self) -> None:
        claim = figures.first("full")
        head = SimpleNamespace(kind="salad", linear=8448)
        made = SimpleNamespace(backbone=ViTConfig(768, 12, 12), aggregator=head)
        megaloc = SimpleNamespace(dim=8448, preprocessing=PAPERS, config=made)
        assert list(rows.unlike(claim, megaloc)) == ["a last linear layer, which the paper's has not"]
        made.aggregator = SaladConfig(768)
        assert list(rows.unlike(claim, megaloc)) == []

    def test_a_size_of_photos_that_is_not_the_papers(self, data: Path, reproduce: Run) -> None:
        ran = reproduce("--sped", data / "SPED", "--only", "full", made=Counting(dim=8448))
        assert ran.code == 0
        assert ran.of("full", "sped")["aside"] == ["photos of another size than the paper's 322 x 322"]

    def test_the_shipped_model_for_real(self, data: Path, tmp_path: Path) -> None:
        main = reproduce_paper.main
        to = tmp_path / "to"
        taken = ["--sped", str(data / "SPED"), "--to", str(to)]
        assert main([*taken, "--backbone", "salad-lite", "--only", "salad-lite"]) == 0
        (one,) = json.loads((to / "reproduction.json").read_text())["figures"]
        assert (one["result"]["recall"]["1"], one["dim"]) == (100.0, 8448)

    def test_a_file_that_is_another_model(self, data: Path, tmp_path: Path, capsys: Any) -> None:
        shipped = path_of("salad-lite")
        assert reproduce_paper.main([str(data), "--medium", str(shipped), "--to", str(tmp_path)]) == 2
        said = capsys.readouterr().err
        for part in (
            "8,448 numbers, the paper's has 2,112",
            "another size",
            "another backbone",
            "give the file",
        ):
            assert part in said


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            ((), "no data set to run on"),
            (("absent",), "there is no folder absent"),
            (("{data}", "--medium", "absent.ckpt"), "there is no model absent.ckpt"),
            (("{data}", "--full", "megaloc"), "megaloc is not the paper's full model"),
            (("{data}", "--small", "dinov2-salad"), "not the paper's small model"),
            (("{data}", "--backbone", "dinov2-vits14", "--backbone", "dinov2-vits14"), "give each once"),
            (("{data}", "--only", "huge"), "there is no such row; there are full, dinov2-vitb14"),
            (("{data}", "--runs", "{data}"), "holds no model of a run"),
            (("{data}", "--sped", "{data}/MSLS"), "sped is not in"),
            (("{data}", "--batch-size", "0"), "give 1 or more"),
        ],
    )
    def test_is_refused_in_a_sentence(self, data: Path, reproduce: Run, arguments: tuple[str, ...], said: str) -> None:
        ran = reproduce(*(one.format(data=data) for one in arguments))
        assert (ran.code, ran.figures) == (2, [])
        assert said in ran.err

    def test_a_folder_that_cannot_be_written(self, data: Path, tmp_path: Path, capsys: Any) -> None:
        (tmp_path / "file").touch()
        arguments = [str(data), "--to", str(tmp_path / "file")]
        assert reproduce_paper.main(arguments, load=lambda *_, **__: model()) == 2

    def test_options_that_are_none(self) -> None:
        with pytest.raises(SystemExit) as left:
            reproduce_paper.main(["--nonsense"])
        assert left.value.code == 2


def test_help_names_every_option() -> None:
    command = [sys.executable, "-m", "benchmarks.paper.reproduce", "--help"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for option in (
        "--msls-val",
        "--nordland",
        "--pitts250k",
        "--sped",
        "--medium",
        "--small",
        "--runs",
        "--to",
    ):
        assert option in told


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_the_script_takes_folders_from_where_one_is(tmp_path: Path) -> None:
    """`scripts/env` goes to the checkout; a folder that somebody names is not there."""
    root, here = tmp_path / "a checkout", tmp_path / "here"
    for folder in (root / "scripts", root / "bin", here):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "scripts" / "reproduce-paper", root / "scripts")
    (root / "scripts" / "env").write_text('cd "$(dirname "${BASH_SOURCE[0]}")/.."\nexport PATH="$PWD/bin:$PATH"\n')
    (root / "bin" / "python").write_text('#!/bin/sh\npwd\nprintf "%s\\n" "$PYTHONPATH" "$@"\nexit 7\n')
    (root / "bin" / "python").chmod(0o755)
    command = ["bash", "../a checkout/scripts/reproduce-paper", "my sets", "--only", "full"]
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ran = subprocess.run(command, cwd=here, env=own, capture_output=True, text=True, check=False)
    assert ran.stdout.splitlines() == [
        str(here),
        str(root),
        *("-P", "-m", "benchmarks.paper.reproduce"),
        *("my sets", "--only", "full"),
    ]
    assert ran.returncode == 7
