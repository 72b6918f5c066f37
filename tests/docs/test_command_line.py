"""The page on the command line names every command and every option, shows each by example, and invents none."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator

import pytest

from salad.cli.main import COMMANDS, command_class, run

PAGE = "docs/reference/command-line.md"
OPTION = re.compile(r"(?<![\w-])--?[a-z][a-z-]*\b")
EVERYWHERE = {"-h", "--help"}


def _help(command: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert run([*command, "--help"]) == 0
    return capsys.readouterr().out


def _below(told: str) -> list[str]:
    """The commands that a help lists as its own."""
    if "subcommands" not in told:
        return []
    listed = re.search(r"\{([a-z,-]+)\}", told)
    assert listed
    return listed[1].split(",")


def _options(told: str) -> set[str]:
    """The options that a help lists: those that begin a line, up to their meaning."""
    begun = re.findall(r"^[│ ] (--?[a-z].*?)(?:  |$)", told, flags=re.MULTILINE)  # tyro draws boxes where it can
    return {option for line in begun for option in OPTION.findall(line)} - EVERYWHERE


@pytest.fixture
def real(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, set[str]]]:
    """The parser's own word: the options of every command, of those below it too."""
    monkeypatch.setenv("COLUMNS", "300")  # no line is wrapped
    found: dict[str, dict[str, set[str]]] = {}
    for name in _below(_help([], capsys)):
        told = _help([name], capsys)
        below = {f"{name} {part}": _options(_help([name, part], capsys)) for part in _below(told)}
        found[name] = below or {name: _options(told)}
    assert set(found) == set(COMMANDS)
    assert len({option for commands in found.values() for options in commands.values() for option in options}) > 100
    return found


def _sections(page: str) -> dict[str, str]:
    parts = re.split(r"^## salad ([a-z-]+)\n", page, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def _examples(page: str) -> Iterator[list[str]]:
    """The words of every command of salad in a page's blocks, of those behind a pipe too."""
    for block in re.findall(r"^```(?:console|bash|sh)?\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            for part in _piped(line.removeprefix("$ ")):
                if part[:1] == ["salad"]:
                    yield part[1:]


def _piped(line: str) -> Iterator[list[str]]:
    try:
        words = shlex.split(line, comments=True)
    except ValueError:  # a block of some other kind: a picture in letters, say
        return
    while "|" in words:
        yield words[: words.index("|")]
        words = words[words.index("|") + 1 :]
    yield words[: words.index(">")] if ">" in words else words


def test_every_command_and_option_is_shown(pages: dict[str, str], real: dict[str, dict[str, set[str]]]) -> None:
    sections = _sections(pages[PAGE])
    assert list(sections) == list(real), "a section for each command, in the order of `salad --help`"
    for name, commands in real.items():
        shown = [" ".join(words) for words in _examples(sections[name])]
        for command, options in commands.items():
            mine = [line for line in shown if f"{line} ".startswith(f"{command} ")]
            assert mine, f"no example of `salad {command}`"
            for option in options:
                assert re.search(rf"(?<![\w-]){option}(?![\w-])", sections[name]), f"{command}: {option}"
                by_example = {option, option.replace("--no-", "--"), option.replace("--", "--no-", 1)}
                by_example |= {"-k"} if option == "--k" else set()  # one option by two names
                assert any(by_example & set(line.split()) for line in mine), f"no example of {command} {option}"


def test_no_option_is_invented(pages: dict[str, str], real: dict[str, dict[str, set[str]]]) -> None:
    every = {option for commands in real.values() for options in commands.values() for option in options}
    for name, section in _sections(pages[PAGE]).items():
        mine = set().union(*real[name].values())
        for row in re.findall(r"^\| (`-.*?) \|", section, flags=re.MULTILINE):
            assert set(OPTION.findall(row)) <= mine, f"{name}: {row}"
        assert set(OPTION.findall(section)) <= every | EVERYWHERE | {"-newer"}, name


def test_every_example_is_understood(pages: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in COMMANDS:
        monkeypatch.setattr(command_class(name), "run", lambda self: 0)  # parsed for real, and no more
    assert len(list(_examples(pages[PAGE]))) > 60
    for name, page in pages.items():
        for words in _examples(page):
            if not {"...", "…"} & set(words):  # what stands for the rest of a line
                assert run(words) == 0, f"{name}: {words}"


def test_the_docs_know_no_other_command(pages: dict[str, str]) -> None:
    for name, page in pages.items():
        for command in re.findall(r"`salad ([a-z][a-z-]*)", page):
            planned = (command, name) == ("pairs", "docs/tutorials/sfm.md")  # said to be missing
            assert command in COMMANDS or planned, f"{name}: {command}"
