"""What a sentence says of what the system refused: its reason, and neither a number nor Python's way to show it."""

from __future__ import annotations

import ast
import errno
from pathlib import Path

import pytest

from salad.errors import reason

SOURCES = sorted(Path(__file__).parents[1].joinpath("src", "salad").rglob("*.py"))


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "a.csv"), "No space left on device"),
        (OSError("it is odd"), "it is odd"),
        (ValueError("it is no table"), "it is no table"),
    ],
)
def test_a_reason_is_words(error: Exception, told: str) -> None:
    assert reason(error) == told


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: "/".join(path.parts[-2:]))
def test_no_sentence_holds_an_error_of_the_system_as_python_shows_it(source: Path) -> None:
    handlers = (node for node in ast.walk(ast.parse(source.read_text("utf-8"))) if isinstance(node, ast.ExceptHandler))
    for handler in handlers:
        if handler.type is not None and "OSError" in ast.unparse(handler.type):
            shown = [
                each.lineno
                for each in ast.walk(handler)
                if isinstance(each, ast.FormattedValue) and ast.unparse(each.value) == handler.name
            ]
            assert not shown, f"{source}, line {shown[0]}: say {{reason(error)}}, or {{error.strerror}}"
