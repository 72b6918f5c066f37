"""How commands speak: results to stdout, talk and progress to stderr; and what their exit codes mean."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

FOUND, NOTHING, BAD_INPUT, INTERRUPTED = (
    0,
    1,
    2,
    130,
)  # 1 as grep has it, 130 as shells have it (128 + SIGINT)
_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_FEW = 20  # things named one by one, where there may be a million
_WIDER_THAN_ANY_TABLE = 10_000  # columns

Progress = Callable[[int, int | None], None]


def settle_streams() -> None:
    """UTF-8 whatever the system's habit; a file name that is no text passes through rather than fails."""
    for stream, errors in ((sys.stdin, "surrogateescape"), (sys.stdout, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):  # tests and notebooks put other things in their place
            stream.reconfigure(encoding="utf-8", errors=errors)


def expand_stdin(names: Iterable[str]) -> Iterator[str]:
    """The names given, with the lines of standard input in place of `-`."""
    for name in names:
        if name != "-":
            yield name
        else:
            from salad.images.photo import listed

            yield from map(str, listed(sys.stdin))


def say(sentence: str) -> None:
    """Talk to whoever watches, in one line on stderr; never part of a result.

    A photo's name may hold anything: what would break the line or command the terminal is shown by its code.
    """
    shown = _CONTROLS.sub(lambda found: repr(found[0])[1:-1], sentence)
    print(shown, file=sys.stderr, flush=True)  # noqa: T201  # the one place for talk


def first_few(sentences: Sequence[str], *, what: str) -> list[str]:
    """The first of many sentences, and how many more `what` there are."""
    more = len(sentences) - _FEW
    return [*sentences[:_FEW], *([f"and {more} more {what}"] if more > 0 else [])]


def write(text: str) -> None:
    """Write a result to stdout."""
    print(text, flush=True)  # noqa: T201  # the one place for results


def write_json(value: Any) -> None:
    """Write a result as JSON, names in any script left readable."""
    write(json.dumps(value, ensure_ascii=False, indent=2))


def write_table(table: Any) -> None:
    """Write one of rich's tables: drawn for a terminal of its width, in full where it is piped."""
    from rich.console import Console

    console = Console()
    console = Console(width=console.width if console.is_terminal else _WIDER_THAN_ANY_TABLE)
    # Written by `write`: rich itself would leave with 1 where a pipe is closed.
    with console.capture() as drawn:
        console.print(table)
    write(drawn.get().removesuffix("\n"))


def write_fields(fields: dict[str, Any]) -> None:
    """Write names and values under one another, for people."""
    wide = max(map(len, fields), default=0)
    for name, value in fields.items():
        write(f"{name.replace('_', ' '):<{wide}}  {_for_people(value)}")


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
        *(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()),
        *(TextColumn("{task.fields[rate]}"), TimeRemainingColumn()),
    )
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(doing, total=None, rate="")

        def report(done: int, total: int | None) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:,.0f}/s" if speed else "")

        yield report
