"""The documentation builds without a warning, and every page of it stands in its navigation."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import salad

ROOT = Path(__file__).resolve().parents[2]
CONFIG = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly in a folder of its own: a warning is an error."""
    pytest.importorskip("zensical", reason="the site is built by the extra `docs`")
    home = tmp_path_factory.mktemp("documentation")
    shutil.copy(ROOT / "zensical.toml", home)
    shutil.copytree(ROOT / "docs", home / "docs")
    shutil.copytree(ROOT / "src" / "salad", home / "src" / "salad", ignore=_but_sources)
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    built = subprocess.run(command, cwd=home, capture_output=True, encoding="utf-8", check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return home / "site"


def _but_sources(folder: str, names: list[str]) -> list[str]:
    """What the Python pages are not made of: weights above all."""
    return [name for name in names if not (name.endswith(".py") or (Path(folder) / name).is_dir())]


class _Links(HTMLParser):
    """What a page fetches when it is opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag in ("script", "img", "source", "iframe"):
            self.fetched.append(named.get("src") or "")
        elif tag == "link" and named.get("rel") in ("stylesheet", "icon", "preload", "preconnect"):
            self.fetched.append(named.get("href") or "")


def test_every_page_is_built_and_fetches_nothing_from_elsewhere(site: Path) -> None:
    built = list(site.rglob("*.html"))
    assert len(built) > 20
    for page in built:
        fetched = _Links(page.read_text(encoding="utf-8")).fetched
        assert fetched
        assert not [link for link in fetched if "//" in link], page


def test_maths_reaches_the_page_as_tex_for_katex(site: Path) -> None:
    method = (site / "method" / "index.html").read_text(encoding="utf-8")
    assert method.count('class="arithmatex"') > 20
    assert "katex.min.js" in method
    styles = (site / "assets" / "katex" / "katex.min.css").read_text(encoding="utf-8")
    fonts = re.findall(r"url\((fonts/[^)]+)\)", styles)
    assert len(fonts) > 10
    assert all((site / "assets" / "katex" / font).is_file() for font in fonts)


def test_every_public_name_has_its_entry(site: Path) -> None:
    page = (site / "reference" / "python" / "index.html").read_text(encoding="utf-8")
    for name in set(salad.__all__) - {"__version__"}:
        assert f'id="salad.{name}"' in page, name


def test_every_page_stands_in_the_navigation() -> None:
    there = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    named = list(_pages(CONFIG["nav"]))
    assert sorted(named) == sorted(there)


def _pages(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [page for part in parts for page in _pages(part)]
