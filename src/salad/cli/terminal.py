"""How commands speak: results to stdout, talk and progress to stderr; and what their exit codes mean."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from salad.errors import SaladError, reason
from salad.files import json_text

FOUND, NOTHING, BAD_INPUT = 0, 1, 2  # 1 as grep has it
_FULL, _LOCKED = "make room, or write elsewhere", "check that you may read and write there"
_ADVICE = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), _FULL),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), _LOCKED),
    errno.ENAMETOOLONG: "give a shorter name",
    errno.EMFILE: "let this process open more files (ulimit -n)",
    errno.EIO: "the disk may be failing: copy what is on it",
}
# Commands of terminals, ends of lines, and what shows the rest of a line from right to left.
_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
_BUT_LINES = re.compile(_CONTROLS.pattern.replace(r"\x00-\x1f", r"\x00-\x08\x0b-\x1f"))
_FEW = 20  # things named one by one, where there may be a million
_WIDER_THAN_ANY_TABLE = 10_000  # columns

Progress = Callable[[int, int | None], None]


def settle_streams() -> None:
    """UTF-8 whatever the system's habit; a file name that is no text passes through rather than fails."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as `>&-` does: else the next file opened would be taken for it
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: PTH123, SIM115  # for as long as we run
    for stream, errors in ((sys.stdin, "surrogateescape"), (sys.stdout, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):  # tests and notebooks put other things in their place
            stream.reconfigure(encoding="utf-8", errors=errors)


def expand_stdin(names: Iterable[str]) -> Iterator[str]:
    """The names given, with the lines of standard input in place of `-`."""
    for name in names:
        if name != "-":
            yield name
        else:
            from salad.images.finding import listed

            yield from map(str, listed(sys.stdin))


def say(sentence: str) -> None:
    """Talk to whoever watches, in one line on stderr; never part of a result.

    A photo's name may hold anything: what would break the line or command the terminal is shown by its code.
    """
    try:
        print(escaped(sentence), file=sys.stderr, flush=True)  # noqa: T201  # the one place for talk
    except OSError:  # nobody listens any more, which is no reason to stop
        _let_go(sys.stderr)


def escaped(text: str) -> str:
    """A text in one line, with what commands a terminal, or would break or turn the line, shown by its code."""
    return _CONTROLS.sub(_code, text)


def _code(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode("ascii")


def of_file(error: OSError) -> str:
    """What the system would not do with a file, and what to do about it: a sentence."""
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
    advice = _ADVICE.get(error.errno or 0, "check the name and permissions")
    return f"{' or '.join(names) or 'a file'} cannot be read or written ({reason(error)}): {advice}"


def first_few(sentences: Sequence[str], *, what: str) -> list[str]:
    """The first of many sentences, and how many more `what` there are."""
    more = len(sentences) - _FEW
    return [*sentences[:_FEW], *([f"and {more} more {what}"] if more > 0 else [])]


def write(text: str) -> None:
    """Write a result to stdout: exact for a file or a program, and nothing that a terminal would obey."""
    _put(_BUT_LINES.sub(_code, text) if sys.stdout.isatty() else text)


def _put(text: str) -> None:
    with results():
        print(text)  # noqa: T201  # the one place for results


def write_line(sentence: str) -> None:
    """Write a result that is one sentence, whatever the names in it hold: to a program it is one line too."""
    write(escaped(sentence))


@contextmanager
def results() -> Iterator[None]:
    """What is written to stdout in the block of this has left us at its end.

    Raises:
        BrokenPipeError: If whoever reads it has gone.
        SaladError: If it cannot be written; where to is not known here.
    """
    try:
        try:
            yield
        finally:  # help leaves the process, with what it said still in the buffer
            sys.stdout.flush()
    except OSError as error:
        _let_go(sys.stdout)
        if isinstance(error, BrokenPipeError):
            raise
        raise SaladError(
            f"standard output cannot be written ({reason(error)}): make room, or write it elsewhere"
        ) from error


def _let_go(stream: TextIO) -> None:
    """Let what a stream holds still go nowhere: Python writes it out once more as it leaves, and would complain."""
    with suppress(OSError, AttributeError):  # what tests put in its place is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def write_json(value: Any) -> None:
    """Write a result as JSON, names in any script left readable."""
    write(json_text(value))


def write_table(table: Any) -> None:
    """Write one of rich's tables: drawn for a terminal of its width, in full where it is piped."""
    from rich.console import Console
    from rich.segment import Segment, Segments

    ours = Console()
    drawn = io.StringIO()  # and from there by `_put`, which knows what to do where it can be written no further
    width = ours.width if ours.is_terminal else _WIDER_THAN_ANY_TABLE
    # A name is no markup, whatever brackets and colons it has.
    console = Console(file=drawn, width=width, force_terminal=ours.is_terminal, markup=False, emoji=False)
    # What rich draws commands the terminal; what it is given must not, and so is looked at before.
    plain = (
        Segment(_BUT_LINES.sub("\N{REPLACEMENT CHARACTER}", text), style) for text, style, _ in console.render(table)
    )
    console.print(Segments(plain), end="")
    _put(drawn.getvalue().removesuffix("\n"))


def write_fields(fields: dict[str, Any]) -> None:
    """Write names and values under one another, for people."""
    wide = max(map(len, fields), default=0)
    for name, value in fields.items():
        write_line(f"{name.replace('_', ' '):<{wide}}  {_for_people(value)}")


def _for_people(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_for_people, value))
    # Six decimals: of a degree, 0.1 m, which is finer than any photo knows its place.
    return "none" if value is None else str(round(value, 6) if isinstance(value, float) else value)


@contextmanager
def progress(doing: str) -> Iterator[Progress]:
    """A bar with rate and time left on stderr while something long is done; nothing where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        *(TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn()),
        *(TextColumn("{task.fields[rate]}"), TimeRemainingColumn()),
    )
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(escaped(doing), total=None, rate="")

        def report(done: int, total: int | None) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:,.0f}/s" if speed else "")

        yield report
