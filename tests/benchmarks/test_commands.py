"""Every command of a benchmark that README, docs or a benchmark itself names is one that can be typed."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.torch  # some of them import it at once

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "benchmarks").rglob("*.py")),
]
RUN = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if "__main__" in path.read_text(encoding="utf-8")
)


def commands() -> list[tuple[str, str]]:
    """Each command with its options, and the page it stands on; a line that ends in a backslash goes on."""
    found = {}
    for page in PAGES:
        text = re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))
        for command in re.findall(r"python -m (benchmarks\.[^`\n]*)", text):
            found[command.strip()] = str(page.relative_to(ROOT))
    return sorted(found.items())


def ask_for_help(module: str) -> None:
    main = importlib.import_module(module).main
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [module, "--help"])
        with pytest.raises(SystemExit) as left:
            main()
    assert left.value.code == 0


@pytest.mark.parametrize("module", RUN)
def test_help_is_the_docstring_which_says_how_it_is_run(module: str, capsys: pytest.CaptureFixture[str]) -> None:
    ask_for_help(module)
    said = capsys.readouterr().out
    run = "bash scripts/reproduce-paper" if module == "benchmarks.paper.reproduce" else f"python -m {module}"
    assert run in said


@pytest.mark.parametrize(("command", "page"), commands())
def test_a_command_names_a_benchmark_and_options_it_has(
    command: str, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    module = command.split()[0].rstrip(".,;:)")
    assert module in RUN, page
    ask_for_help(module)
    said = capsys.readouterr().out
    options = command.split(" -- ")[0]  # what follows is another command's
    for option in re.findall(r"(?<![\w-])--[a-z][\w-]*", options):
        assert re.search(rf"{option}\b(?!-)", said.split("options:")[1]), (page, option)
