"""What README shows must run: its shell lines and its Python, on photos of a small drawn town."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from salad.cli.main import run
from salad.demo.town.town import draw_town

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def mapper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as README's reader has it: `holiday/`, `queries/` and `query.jpg`."""
    home = tmp_path_factory.mktemp("mapper")
    town = draw_town(home / "town", references=6, queries=2, size=(160, 120), workers=1)
    shutil.copytree(town.references[0].parent, home / "holiday")
    shutil.copytree(town.queries[0].parent, home / "queries")
    shutil.copy(town.queries[0], home / "query.jpg")
    return home


def test_readme_runs(
    mapper: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(mapper)
    lines = [line for block in _blocks("bash") for line in block.splitlines() if line.strip()]
    assert len(lines) >= 3
    for line in lines:
        words = shlex.split(line, comments=True)
        assert words[0] == "salad", line
        words = words[: words.index(">")] if ">" in words else words
        assert run(words[1:]) in (0, 1), line  # so few photos may leave a place unknown: 1
    (python,) = _blocks("python")
    exec(compile(python, "README.md", "exec"), {})
    assert "alike:" in capsys.readouterr().out


def test_readme_names_files_that_are_there() -> None:
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in link]
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


def test_readme_shows_the_two_commands_and_real_options() -> None:
    consoles = "\n".join(_blocks("console"))
    assert "bash scripts/demo" in consoles
    assert "bash scripts/test" in consoles
    for line in consoles.splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["salad"]:
            with pytest.raises(SystemExit) as left:  # the command exists: its help can be shown
                run([*words[1 : 3 if words[1] == "weights" else 2], "--help"])
            assert left.value.code == 0


def test_every_script_the_docs_name_is_there() -> None:
    for page in (README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))):
        for name in re.findall(r"\b((?:benchmarks|scripts)/[\w.-]*\w)", page):
            assert (ROOT / name).exists(), name
