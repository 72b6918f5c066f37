"""What holds for every page: one escape rule, whole or not at all, and no markup in Python."""

import ast
import math
import re
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jinja2 import UndefinedError

from pages import Page
from salad import demo, report
from salad.errors import BenchmarkError
from salad.geo import told_metres
from salad.report.map import QueryMark
from salad.report.page import environment, ordinal, render, several, write_page

TEMPLATES = files("salad.report").joinpath("templates")


def test_no_markup_is_written_in_python() -> None:
    for package in (report, demo):
        for path in Path(package.__path__[0]).rglob("*.py"):
            texts = [
                node.value for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Constant)
            ]
            marked = [text for text in texts if isinstance(text, str) and re.search(r"</?[a-z]+[ />]", text)]
            assert not marked, path


def test_no_template_leaves_the_escape_rule() -> None:
    for path in TEMPLATES.iterdir():
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\|\s*safe\b|autoescape|Markup", text), path.name
        if path.name.endswith((".css", ".js")):
            assert not re.search(r"\{[{%#]|</", text), path.name  # nothing is filled in, and nothing ends it early
            assert text.count("{") == text.count("}"), path.name


def test_the_template_engine_is_loaded_by_the_first_page() -> None:
    asked = "import salad.report.page, sys; print('jinja2' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


@given(st.text(max_size=40))
def test_any_name_is_text_on_a_page(name: str) -> None:
    mark = QueryMark(1, "right", name)
    macro = "{% from 'map.html.j2' import query %}{% call query(mark, data) %}{% endcall %}"
    text = environment().from_string(macro).render(mark=mark, data={"data-condition": name})
    page = Page(text)
    link = page.all("a", "query")[0]
    expected = name.replace("\r\n", "\n").replace("\r", "\n")
    assert {tag for tag, _ in page.tags} == {"a", "title"}
    for told in (link["aria-label"], link["data-condition"]):
        assert (told or "").replace("\r\n", "\n").replace("\r", "\n") == expected


def test_what_a_template_names_must_be_there() -> None:
    with pytest.raises(UndefinedError):
        render("evaluation.html.j2")


def test_the_script_parses(tmp_path: Path) -> None:
    if (node := shutil.which("node")) is None:
        pytest.skip("node is not here")
    script = tmp_path / "demo.js"
    script.write_text(TEMPLATES.joinpath("demo.js").read_text(encoding="utf-8"), encoding="utf-8")
    assert subprocess.run([node, "--check", str(script)], check=False).returncode == 0


def test_an_older_page_survives_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "town.html"
    write_page(page, "older")
    assert page.read_text() == "older"

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(BenchmarkError, match=r"town\.html cannot be written.*another folder"):
        write_page(page, "newer")
    assert page.read_text() == "older"
    assert list(tmp_path.iterdir()) == [page]


def test_a_page_is_written_only_where_a_folder_is(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="name a file in a folder"):
        write_page(tmp_path / "no" / "page.html", "")


def test_words() -> None:
    assert [ordinal(n) for n in (1, 2, 3, 4, 11, 12, 13, 21, 102, 111)] == [
        *("1st", "2nd", "3rd", "4th", "11th", "12th", "13th", "21st", "102nd", "111th")
    ]
    assert several(1, "query", "queries") == "1 query"
    assert several(2000, "photo") == "2,000 photos"
    assert [told_metres(m) for m in (0.04, 9.94, 9.96, 999.4, 999.5, 1234567, math.inf)] == [
        *("0.0 m", "9.9 m", "10 m", "999 m", "1.0 km", "1,234.6 km", "infinitely far")
    ]
