"""What a folder is: which protocols fit it, and what keeps the others from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from salad.datasets.check_folder import check
from salad.datasets.protocols import PROTOCOLS
from salad.errors import BenchmarkError


def test_a_set_that_fits(tmp_path: Path, fakes: ModuleType) -> None:
    findings = check(fakes.numbered(tmp_path, range(607), range(607)))
    assert [finding.protocol for finding in findings if finding.fits] == ["sped", "folder", "frames"]
    sped, nordland = findings[0], next(f for f in findings if f.protocol == "nordland-10f")
    assert (sped.layout, sped.references, sped.queries, sped.unanswerable) == ("drives", 607, 607, 0)
    assert nordland.missing == ("expected 27,592 references, found 607",)


def test_by_the_folders_name(tmp_path: Path, fakes: ModuleType) -> None:
    root = fakes.at_names(tmp_path / "st_lucia", [0.0, 9.0], [0.0, 900.0])
    fitting = {finding.protocol: finding for finding in check(root) if finding.fits}
    assert set(fitting) == {"st-lucia", "folder", "frames"}
    assert fitting["st-lucia"].unanswerable == 1


def test_what_is_wrong_is_said(tmp_path: Path, fakes: ModuleType) -> None:
    (tmp_path / "pitts30k_test.mat").write_bytes(b"no")
    fakes.numbered(tmp_path, range(40), range(5))
    findings = {(finding.protocol, finding.layout): finding for finding in check(tmp_path)}
    broken = findings["pitts30k-test", "dbStruct"]
    assert (broken.fits, broken.references) == (False, None)
    assert "no whole MATLAB file" in broken.missing[0]


def test_queries_that_differ(tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.numbered(tmp_path, range(40), range(5))
    for name in ("nordland-1f", "nordland-2f"):
        monkeypatch.setitem(PROTOCOLS, name, replace(PROTOCOLS[name], references=40, queries=9))
    findings = {finding.protocol: finding for finding in check(tmp_path)}
    assert findings["nordland-1f"].missing == ("expected 9 queries, found 5",)
    assert "without a gap" in findings["nordland-2f"].missing[0]


def test_own_table(shared: Path) -> None:
    fitting = [finding.protocol for finding in check(shared / "data" / "eval" / "toy") if finding.fits]
    assert fitting == ["folder", "frames", "truth"]


def test_frames_need_numbers(tmp_path: Path, fakes: ModuleType) -> None:
    fakes.touch(tmp_path / "database", ["a.jpg"])
    fakes.touch(tmp_path / "queries", ["1.jpg"])
    findings = {finding.protocol: finding for finding in check(tmp_path)}
    assert findings["folder"].fits
    assert not findings["frames"].fits
    assert "a.jpg has no number" in findings["frames"].missing[0]


def test_nothing_and_no_folder(tmp_path: Path) -> None:
    assert check(tmp_path) == []
    with pytest.raises(BenchmarkError, match="there is no folder"):
        check(tmp_path / "absent")
