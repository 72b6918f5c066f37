"""Pages are followed as a reader follows them: their commands and their Python, in order, in an empty folder."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from salad.cli.main import run
from salad.demo.town.town import draw_town

ROOT = Path(__file__).resolve().parents[2]

# Done once before the page is read: the package is there already, and nothing is fetched.
SET_UP = ("pip install", "git clone", "source ", "cd salad", "bash scripts/")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: its language, its lines, and where it stands."""

    language: str
    text: str
    line: int


def blocks_of(page: str) -> Iterator[Block]:
    """Every fenced block, in order."""
    for found in re.finditer(r"^```(\w*)[^\n]*\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL):
        yield Block(found[1], found[2], page[: found.start()].count("\n") + 1)


def commands_of(block: Block) -> Iterator[str]:
    """The commands of a block: continued lines joined, comments gone."""
    for line in block.text.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            bare = re.sub(r"\s+# .*", "", line).strip()
            assert shlex.split(bare) == words, f"a comment is cut wrongly: {line}"
            yield bare


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `salad demo` leaves, smaller: 24 photos of a drive, 8 of later visits, and an index."""
    home = tmp_path_factory.mktemp("drawn")
    draw_town(home / "town", references=24, queries=8, size=(240, 180), workers=1)
    assert run(["index", str(home / "town" / "references"), "--to", str(home / "town.index")]) == 0
    return home


@pytest.fixture
def follow(town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], int]:
    """Follows a page in an empty folder, and says how many blocks it held.

    Blocks `console` and `bash` are commands, each of which must come to a good end; blocks `python` share their
    names from first to last. Blocks of other languages (`text` for output, `sh` for what takes another program
    or somebody's data set) are not run.
    """
    monkeypatch.chdir(tmp_path)

    def followed(page: str) -> int:
        names: dict[str, Any] = {"__name__": "__main__"}
        count = 0
        for block in blocks_of(page):
            if block.language in ("console", "bash"):
                for command in commands_of(block):
                    _obey(command, town, f"line {block.line}: {command}")
            elif block.language == "python":
                # As many empty lines before it as the page has, so that a traceback names the page's line.
                exec(compile("\n" * block.line + block.text, "the page", "exec"), names)
            else:
                continue
            count += 1
        return count

    return followed


def _obey(command: str, town: Path, where: str) -> None:
    if command.startswith(SET_UP):
        return
    words = shlex.split(command)
    if words[:2] == ["salad", "demo"]:
        shutil.copytree(town, "demo", dirs_exist_ok=True)
    elif words[0] == "salad" and "|" not in words:
        target = words[words.index(">") + 1] if ">" in words else None
        arguments = words[1 : words.index(">")] if target else words[1:]
        said = StringIO()
        with redirect_stdout(said):
            code = run(arguments)
        assert code == 0, f"{where} came to exit code {code}"
        if target:
            Path(target).write_text(said.getvalue(), encoding="utf-8")
    else:
        subprocess.run(["bash", "-euo", "pipefail", "-c", command], check=True)


@pytest.fixture(scope="session")
def pages() -> dict[str, str]:
    """Every page of the documentation and README.md, by its path from the root."""
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8") for file in files}
