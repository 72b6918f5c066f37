"""A line of CSV comes back as it was written, whatever its values hold."""

import csv
import io

from hypothesis import example, given
from hypothesis import strategies as st

from salad.tables import csv_line

# a field of nothing and a line of one such field are written alike, and read as no line
LINES = st.lists(st.lists(st.text(st.characters(exclude_categories=["Cs"])), min_size=2), max_size=4)


@given(LINES)
@example([["a\rb", "\r"], ["\n", "\r\n"], ['"', ","]])
def test_lines_come_back_as_they_were_written(lines: list[list[str]]) -> None:
    text = "".join(map(csv_line, lines))
    assert list(csv.reader(io.StringIO(text, newline=""), strict=True)) == lines


def test_a_line_ends_as_unix_ends_it_and_nothing_known_is_an_empty_field() -> None:
    assert csv_line(["a", None, 1.5, ""]) == "a,,1.5,\n"
    assert csv_line(["its last is\r\n"]) == '"its last is\r\n"\n'
