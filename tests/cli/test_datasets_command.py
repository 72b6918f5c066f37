"""`salad datasets`: the protocols listed, a folder told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from salad.cli.datasets_command import CheckFolder, DatasetsCommand, ListProtocols
from salad.datasets.protocols import PROTOCOLS
from salad.errors import BenchmarkError


@pytest.fixture
def sped(tmp_path: Path) -> Path:
    """SPED's folders, of empty photos."""
    for side in ("ref", "query"):
        (tmp_path / side).mkdir()
        for row in range(607):
            (tmp_path / side / f"{row:07d}.jpg").touch()
    return tmp_path


def test_every_protocol_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert DatasetsCommand(ListProtocols()).run() == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["protocol", "references", "queries"]
    assert [line.split()[0] for line in lines[1:]] == list(PROTOCOLS)
    assert "18,871" in lines[1]
    assert any(line.startswith("sfxl-v1 ") and "about 2,800,000" in line for line in lines)


def test_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert ListProtocols(format="json").run() == 0
    rows = {row["protocol"]: row for row in json.loads(capsys.readouterr().out)}
    assert set(rows) == set(PROTOCOLS)
    assert rows["msls-val-740"]["queries"] == 740
    assert rows["folder"]["right when"] == "as your options say"
    assert rows["svox-night"]["references"] is None


def test_a_folder_is_told(sped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert DatasetsCommand(CheckFolder(sped)).run() == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:5] == ["sped", "yes", "drives", "607", "607"]
    assert any("expected 27,592 references, found 607" in line for line in lines)


def test_a_folder_as_json(sped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert CheckFolder(sped, format="json").run() == 0
    first, *_ = json.loads(capsys.readouterr().out)
    assert (first["protocol"], first["fits"], first["missing"]) == ("sped", True, [])


def test_nothing_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert CheckFolder(tmp_path).run() == 1
    told = capsys.readouterr()
    assert "is in no layout known here" in told.err
    assert "gt.csv" in told.err
    assert CheckFolder(tmp_path, format="json").run() == 1
    assert json.loads(capsys.readouterr().out) == []
    with pytest.raises(BenchmarkError, match="no folder"):
        CheckFolder(tmp_path / "absent").run()
