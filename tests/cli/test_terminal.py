"""The manners of the command line: help, streams, exit codes; in this process and as a process of its own."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from salad import __version__
from salad.cli import main as commands
from salad.cli import terminal
from salad.cli.examples import EXAMPLES
from salad.cli.main import COMMANDS, command_class, main, parsed, run

SUBCOMMANDS = [
    *([name] for name in COMMANDS),
    *(["weights", name] for name in ("list", "info", "fetch", "convert")),
]


def process(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """`salad ARGUMENTS` as a process of its own."""
    command = [sys.executable, "-m", "salad", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False, **options)


# --- help ----------------------------------------------------------------------------------


def test_help_names_every_command(cli: Any) -> None:
    ran = cli("--help")
    assert (ran.code, ran.err) == (0, "")
    for name in COMMANDS:
        assert f"• {name} " in ran.out


@pytest.mark.parametrize("command", SUBCOMMANDS, ids=" ".join)
def test_every_command_has_help(cli: Any, command: list[str]) -> None:
    ran = cli(*command, "--help")
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.startswith(f"usage: salad {' '.join(command)} ")
    assert "None" not in ran.out  # what is left out is told in words
    assert "(default: )" not in ran.out


@pytest.mark.parametrize(
    "line", [["--help"], ["locate", "--help"], ["weights", "--help"], [], ["nope"], ["locate", "a.jpg"]], ids=" ".join
)
def test_a_command_that_stands_for_another_is_never_seen(
    cli: Any, line: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the command that is asked for is built in full, and yet nobody can tell."""
    ran = cli(*line)
    monkeypatch.setattr(commands, "commands_for", lambda _: {name: commands.command_class(name) for name in COMMANDS})
    assert cli(*line) == ran


def test_help_loads_nothing_heavy() -> None:
    script = (
        "import sys, salad.cli.main\n"
        "for line in (['--help'], *([name, '--help'] for name in salad.cli.main.COMMANDS)):\n"
        "    assert salad.cli.main.run(line) == 0\n"
        "heavy = {'torch', 'numpy', 'PIL', 'rich', 'jaxtyping', 'lightning_fabric', 'kornia', 'scipy'}\n"
        "heavy &= set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "usage: salad" in ran.stdout


def test_the_version_is_told(cli: Any) -> None:
    assert cli("--version").out == f"salad {__version__}\n"


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nope"],
        ["weights"],
        ["info"],
        ["locate", "a.jpg"],
        ["index", "a.jpg", "--too", "x"],
        ["info", "a", "b"],
    ],
    ids=" ".join,
)
def test_a_command_line_that_makes_no_sense_is_bad_input(cli: Any, arguments: list[str]) -> None:
    ran = cli(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err
    assert "Traceback" not in ran.err


# --- leaving -------------------------------------------------------------------------------


def test_main_leaves_with_the_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["info", str(tmp_path)])
    assert left.value.code == 2
    assert "is not an index" in capsys.readouterr().err


def test_main_reads_the_process_s_arguments(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["salad", "--version"])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 0
    assert capsys.readouterr().out == f"salad {__version__}\n"


def test_an_interrupt_is_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("salad.index.index.Index.open", interrupt)
    assert run(["info", "x"]) == 130
    assert capsys.readouterr().err.startswith("salad: interrupted")


def test_an_error_of_ours_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(*_: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("salad.index.index.Index.open", bug)
    with pytest.raises(ZeroDivisionError):
        run(["info", "x"])


@pytest.mark.parametrize("name", COMMANDS)
def test_help_ends_with_two_lines_that_can_be_copied(name: str, cli: Any) -> None:
    helped = cli(name, "--help")
    assert (helped.code, helped.err) == (0, "")
    *_, heading, first, second = helped.out.splitlines()
    assert (heading, first.strip(), second.strip()) == ("examples:", *EXAMPLES[name])
    for line in EXAMPLES[name]:
        program, *arguments = shlex.split(line.partition(" > ")[0])
        assert (program, arguments[0]) == ("salad", name)
        assert isinstance(parsed(arguments), command_class(name))


@pytest.mark.parametrize(
    ("slip", "meant"),
    [("locat", "locate"), ("lcoate", "locate"), ("indx", "index"), ("exportmodel", "export-model"), ("zzz", "--help")],
)
def test_a_command_written_wrong_is_guessed(slip: str, meant: str, cli: Any) -> None:
    ran = cli(slip, "x", "--index", "y")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith(f"salad: there is no command '{slip}'")
    assert meant in ran.err


def test_the_version_has_a_short_name(cli: Any) -> None:
    assert cli("-V").out == cli("--version").out


LINES = [["weights", "list"], ["--help"], ["locate", "--help"], ["--version"]]


@pytest.mark.parametrize("line", LINES, ids=" ".join)
def test_a_reader_that_has_seen_enough_is_no_error(line: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "salad", *line]
    ran = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, encoding="utf-8", check=False)
    os.close(writing)
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.fixture
def full() -> Iterator[int]:
    """A file that takes nothing."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no device that is always full")
    with Path("/dev/full").open("wb") as device:
        yield device.fileno()


@pytest.mark.parametrize("line", LINES, ids=" ".join)
def test_a_full_disk_under_stdout_is_told(line: list[str], full: int) -> None:
    command = [sys.executable, "-m", "salad", *line]
    ran = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, encoding="utf-8", check=False)
    assert ran.returncode == 2
    assert ran.stderr == (
        "salad: standard output cannot be written (No space left on device): make room, or write it elsewhere\n"
    )


def test_talk_that_nobody_can_hear_stops_nothing(full: int) -> None:
    command = [sys.executable, "-m", "salad", "info", "nothing"]
    assert subprocess.run(command, stderr=full, check=False).returncode == 2


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX closes the streams")
@pytest.mark.parametrize(("line", "code"), [(["weights", "list"], 0), (["nope"], 2), (["index", "-", "--to", "x"], 2)])
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_streams_may_be_closed(line: list[str], code: int, closed: str, tmp_path: Path) -> None:
    if "-" in line and "<" not in closed:
        closed += " </dev/null"
    command = ["/bin/sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-m", "salad", *line]
    ran = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert ran.returncode == code
    assert "Traceback" not in ran.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device", "a.csv"),
            "a.csv cannot be read or written (No space left on device): make room, or write elsewhere",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", b"a"),
            "a cannot be read or written (Permission denied): check that you may read and write there",
        ),
        (
            OSError(errno.EXDEV, "Invalid cross-device link", "a", None, "b"),
            "a or b cannot be read or written (Invalid cross-device link): check the name and permissions",
        ),
        (OSError("odd"), "a file cannot be read or written (odd): check the name and permissions"),
    ],
)
def test_what_the_system_refuses_is_a_sentence_that_names_the_file(
    error: OSError, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any) -> None:
        raise error

    monkeypatch.setattr("salad.index.index.Index.open", refuse)
    assert run(["info", "x"]) == 2
    assert capsys.readouterr().err == f"salad: {told}\n"


def test_too_little_memory_is_a_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def ask(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("salad.index.index.Index.open", ask)
    assert run(["info", "x"]) == 2
    assert capsys.readouterr().err.startswith("salad: this takes more memory than there is")


def test_names_of_any_script_come_out_whatever_the_system_s_habit(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "PYTHONIOENCODING": "ascii",
        "PYTHONUTF8": "0",
        "SALAD_HOME": str(tmp_path / "東京"),
    }
    ran = process("weights", "info", "megaloc", env=environment)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert str(tmp_path / "東京") in ran.stdout


def test_a_name_that_is_no_text_passes_through(tmp_path: Path) -> None:
    environment = {**os.environb, b"SALAD_HOME": os.fsencode(tmp_path) + b"/\xff"}
    ran = process("weights", "info", "megaloc", env=environment)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "/\\udcff/" in ran.stdout


# --- streams -------------------------------------------------------------------------------


def test_a_list_on_stdin_may_hold_any_name(monkeypatch: pytest.MonkeyPatch) -> None:
    given = io.TextIOWrapper(io.BytesIO("東京 1.jpg\r\n\n b .jpg\n".encode() + b"\xff.jpg\nlast.jpg"), encoding="ascii")
    monkeypatch.setattr(sys, "stdin", given)
    terminal.settle_streams()
    assert list(terminal.expand_stdin(["first.jpg", "-", "end"])) == [
        *("first.jpg", "東京 1.jpg", " b .jpg", "\udcff.jpg", "last.jpg", "end")
    ]


def test_facts_are_told_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.write_fields({"with_position": 3, "box": None, "at": (48.1234567891, 11.5), "note": "[red] a"})
    assert capsys.readouterr().out.splitlines() == [
        "with position  3",
        "box            none",
        "at             48.123457, 11.5",
        "note           [red] a",
    ]


def test_no_facts_are_no_lines(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.write_fields({})
    assert capsys.readouterr().out == ""


def test_a_piped_table_is_whole(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("name", box=None)
    table.add_row("x" * 700)
    terminal.write_table(table)
    assert "x" * 700 in capsys.readouterr().out


def test_progress_is_silent_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.progress("indexing") as bar:
        bar(1, 2)
    assert capsys.readouterr() == ("", "")


def test_progress_is_drawn_on_stderr_for_who_watches(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # as a terminal would
    with terminal.progress("indexing") as bar:
        bar(0, None)
        bar(1, 2)
        bar(2, 2)
    out, err = capsys.readouterr()
    assert out == ""
    assert "indexing" in err
    assert "2/2" in err


def test_a_name_cannot_break_the_line_or_command_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.say("a\nb\x1b[2J\u2028 東京 é.jpg is empty")
    assert capsys.readouterr().err == "a\\nb\\x1b[2J\\u2028 東京 é.jpg is empty\n"


COMMANDING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
NAMES = st.text(st.characters(exclude_categories=["Cs"]) | st.sampled_from("\x1b\x9b\u202e\n\r[]:/=a"))


class Watched(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


@given(name=NAMES)
def test_nothing_that_is_written_for_people_commands_a_terminal(name: str) -> None:
    with pytest.MonkeyPatch.context() as here:
        here.setenv("TERM", "dumb")  # where rich draws no commands of its own
        here.setattr(sys, "stdout", Watched())
        terminal.write(name)
        terminal.write_line(name)
        terminal.write_json({name: name})
        terminal.write_fields({"name": name, "names": [name]})
        table = Table("name", name, box=None)
        table.add_row(name, name)
        terminal.write_table(table)
        assert not COMMANDING.search(sys.stdout.getvalue())


@given(name=NAMES)
def test_a_result_is_exact_where_a_program_reads_it_and_a_sentence_is_one_line(name: str) -> None:
    with pytest.MonkeyPatch.context() as here:
        for write, told in ((terminal.write, f"{name}\n"), (terminal.write_line, f"{terminal.escaped(name)}\n")):
            here.setattr(sys, "stdout", io.StringIO())
            write(name)
            assert sys.stdout.getvalue() == told
        assert len(terminal.escaped(name).splitlines()) <= 1
        here.setattr(sys, "stdout", io.StringIO())
        terminal.write_json([name])
        assert json.loads(sys.stdout.getvalue()) == [name]
        assert not COMMANDING.search(re.sub("[\u202a-\u202e\u2066-\u2069]", "", sys.stdout.getvalue()))


def test_a_table_takes_no_name_for_markup(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("name", box=None)
    table.add_row("[red]a[/b] :smile:")
    terminal.write_table(table)
    assert "[red]a[/b] :smile:" in capsys.readouterr().out
    with terminal.progress("[/b] :smile:") as bar:
        bar(0, 1)


def test_no_name_forges_a_line_of_what_verify_says(cli: Any, city: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("salad.index.index.Index.verify", lambda _: [f"a\n{city} is sound: 6 photos\x1b[8m is damaged"])
    ran = cli("verify", city)
    assert (ran.code, ran.out) == (1, f"a\\n{city} is sound: 6 photos\\x1b[8m is damaged\n")


@pytest.mark.parametrize(("many", "lines", "last"), [(0, 0, ""), (20, 20, "19"), (1000, 21, "and 980 more are gone")])
def test_a_million_sentences_are_not_said_one_by_one(many: int, lines: int, last: str) -> None:
    said = terminal.first_few([str(number) for number in range(many)], what="are gone")
    assert (len(said), said[-1] if said else "") == (lines, last)
