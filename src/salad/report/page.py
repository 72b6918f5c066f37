"""A page: one HTML file that needs nothing else, filled from a Jinja2 template that escapes every name.

templates/base.html.j2 ──> evaluation.html.j2, demo.html.j2
map.html.j2, strip.html.j2, charts.html.j2, figures.html.j2: what the pages share, with one style.css
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from salad._version import __version__
from salad.errors import BenchmarkError, reason
from salad.files import write_whole
from salad.geo import told_metres

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **content: object) -> str:
    """Fill a template.

    Args:
        template: Its file in `templates/`.
        content: What it names. Text is escaped wherever it lands, so nothing here is ever markup.

    Returns:
        The page. Letters that no page can hold (half of a surrogate pair, as names of files that are no text
        have) are question marks in it.
    """
    text = environment().get_template(template).render(content, version=__version__)
    return text.encode("utf-8", "replace").decode("utf-8")


def write_page(page: Path, text: str) -> None:
    """Write a page; an older one is replaced whole or not at all.

    Raises:
        BenchmarkError: If it cannot be written.
    """
    try:
        write_whole(page, text.encode("utf-8"))
    except OSError as error:
        raise BenchmarkError(
            f"{page} cannot be written ({reason(error)}): name a file in a folder that is there, "
            "or choose another folder"
        ) from error


@cache
def environment() -> Environment:
    """How every template is filled."""
    # Imported late: whoever locates a photo draws no page, and should not wait for a template engine.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("salad.report"),
        autoescape=True,  # in every file, whatever its ending: an unescaped name is how a page is attacked
        undefined=StrictUndefined,  # a misspelt name stops here instead of leaving a hole in the page
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {
        "dec": lambda value, digits=1: f"{value:.{digits}f}",
        "thousands": lambda value, digits=0: f"{value:,.{digits}f}",
        "repr": repr,  # all digits of a figure, for programs that read the page
        "metres": told_metres,
        "bar_metres": lambda metres: f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m",
        "ordinal": ordinal,
        "several": several,
    }
    return made


def ordinal(number: int) -> str:
    """`1st`, `2nd`, `13th`."""
    teen = number % 100 in (11, 12, 13)
    return f"{number}{'th' if teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def several(number: int, one: str, many: str = "") -> str:
    """`1 query`, `2 queries`."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"
