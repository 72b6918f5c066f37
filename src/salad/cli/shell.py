"""The manners of the shell: results to stdout, talk and progress to stderr, one sentence for what went wrong."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

FOUND, NOTHING, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_NAMED = 20  # things named one by one where there may be a million
_WHOLE = 10_000  # columns: wider than any table

Progress = Callable[[int, int | None], None]


def settle_streams() -> None:
    """UTF-8 whatever the system's habit; a file name that is no text passes through rather than fails."""
    for stream, errors in ((sys.stdin, "surrogateescape"), (sys.stdout, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors=errors)


def listed(names: Iterable[str]) -> Iterator[str]:
    """The names, with the lines of standard input in place of `-`."""
    for name in names:
        if name != "-":
            yield name
        else:
            from salad.images.photo import listed as paths_on

            yield from map(str, paths_on(sys.stdin))


def say(sentence: str) -> None:
    """Talk to whoever watches, in one line; never part of a result.

    A photo's name may hold anything: what would break the line or command the terminal is shown by its code.
    """
    shown = _CONTROLS.sub(lambda found: repr(found[0])[1:-1], sentence)
    print(shown, file=sys.stderr, flush=True)  # noqa: T201  # the one place for talk


def some(sentences: Sequence[str], *, what: str) -> list[str]:
    """The first of many sentences, and how many more `what` there are."""
    more = len(sentences) - _NAMED
    return [*sentences[:_NAMED], *([f"and {more} more {what}"] if more > 0 else [])]


def put(text: str) -> None:
    """Write a result."""
    print(text, flush=True)  # noqa: T201  # the one place for results


def put_json(value: Any) -> None:
    """Write a result as JSON, names in any script left readable."""
    put(json.dumps(value, ensure_ascii=False, indent=2))


def put_table(table: Any) -> None:
    """Write a table: drawn for a terminal of its width, whole where it is piped."""
    from rich.console import Console

    console = Console()
    width = console.width if console.is_terminal else _WHOLE
    console = Console(width=width)
    # Written by `put`: rich itself would leave with 1 where a pipe is closed.
    with console.capture() as drawn:
        console.print(table)
    put(drawn.get().removesuffix("\n"))


def facts(pairs: dict[str, Any]) -> None:
    """Write names and values under one another."""
    wide = max(map(len, pairs), default=0)
    for name, value in pairs.items():
        put(f"{name.replace('_', ' '):<{wide}}  {_told(value)}")


def _told(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_told, value))
    return "none" if value is None else str(round(value, 6) if isinstance(value, float) else value)


@contextmanager
def progress(doing: str) -> Iterator[Progress]:
    """A bar with rate and time left on stderr while something long is done; nothing where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(doing, total=None, rate="")

        def report(done: int, total: int | None) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:,.0f}/s" if speed else "")

        yield report
