"""README and the home page run as they stand, on the photos of a small drawn town; what they name is there."""

from __future__ import annotations

import pkgutil
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_readme_runs(
    town: Path, tmp_path: Path, follow: Callable[[str], int], capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(town / "town" / "references", tmp_path / "holiday")  # what README's reader has
    shutil.copytree(town / "town" / "queries", tmp_path / "queries")
    shutil.copy(town / "town" / "queries" / "query_001.jpg", tmp_path / "query.jpg")
    assert follow(README) >= 5
    assert "alike:" in capsys.readouterr().out


@pytest.mark.parametrize("page", ["docs/index.md", "docs/reference/python.md"])
def test_a_page_that_begins_with_the_demo_runs(page: str, pages: dict[str, str], follow: Callable[[str], int]) -> None:
    assert follow(pages[page]) == 2


def test_readme_fits_and_shows_the_two_commands() -> None:
    assert len(README.splitlines()) <= 120
    assert README.index("pip install salad-vpr") < README.index("import salad") < README.index("docs/demo.png")
    assert "bash scripts/demo" in README
    assert "bash scripts/test" in README


def test_every_link_within_the_repository_leads_somewhere(pages: dict[str, str]) -> None:
    """Of README and CONTRIBUTING too, which the site's strict build does not see."""
    seen = 0
    for name, page in pages.items():
        for link in re.findall(r"\]\(([^)\s]+)\)", page):
            if "://" in link:
                continue
            target, _, anchor = link.partition("#")
            file = (ROOT / name).parent / target if target else ROOT / name
            assert file.exists(), f"{name}: {link}"
            if anchor and file.suffix == ".md":
                assert anchor in _anchors(file.read_text(encoding="utf-8")), f"{name}: {link}"
            seen += 1
    assert seen > 50


def _anchors(page: str) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", page, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_script_the_docs_name_is_there(pages: dict[str, str]) -> None:
    for page in pages.values():
        for name in re.findall(r"\b((?:benchmarks|scripts|examples)/[\w./-]*\w)", page):
            assert (ROOT / name).exists(), name


def test_every_source_file_the_docs_name_is_there(pages: dict[str, str]) -> None:
    seen = 0
    for name, page in pages.items():
        for path in set(re.findall(r"`((?:\w+/)*\w+\.py)`", page)):
            there = (ROOT / path).is_file() or any((ROOT / "src" / "salad").rglob(path))
            assert there, f"{name}: {path}"
            seen += 1
    assert seen > 20


@pytest.mark.torch
def test_every_dotted_name_the_docs_use_is_there(pages: dict[str, str]) -> None:
    """`salad.room.module.name`, in prose and in imports: rooms are moved more easily than words about them."""
    named: set[str] = set()
    for page in pages.values():
        named |= {path for path in re.findall(r"`(salad(?:\.\w+)+)", page) if not path.endswith(".py")}
        imports = re.findall(r"^from (salad[\w.]*) import (\w+)$", page, flags=re.MULTILINE)
        named |= {f"{module}.{what}" for module, what in imports}
    assert len(named) > 5
    for path in named:
        assert pkgutil.resolve_name(path) is not None
