"""`salad datasets`: which protocols there are, and what a folder is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg, subcommand

from salad.cli import terminal
from salad.cli.arguments import Format

if TYPE_CHECKING:
    from salad.datasets.readers.base import Protocol


@dataclass(frozen=True)
class ListProtocols:
    """List the protocols: their sets, how many photos, what is right, where to get them."""

    format: Format = "table"

    def run(self) -> int:
        """List."""
        from salad.datasets.protocols import PROTOCOLS

        rows = [_described(protocol) for protocol in PROTOCOLS.values()]
        if self.format == "json":
            terminal.write_json(rows)
            return terminal.FOUND
        shown = (
            *("protocol", "references", "queries", "right when", "unanswerable"),
            *("layouts", "get", "licence"),
        )
        terminal.write_table(_table(shown, (_cells(row, shown) for row in rows)))
        return terminal.FOUND


@dataclass(frozen=True)
class CheckFolder:
    """Say what a folder is: which layouts it is in, how many photos, which protocols fit and what is missing."""

    folder: Annotated[Positional[Path], arg(metavar="DIR", help="The folder of a data set.")]
    format: Format = "table"

    def run(self) -> int:
        """Check."""
        from salad.datasets.check_folder import check

        findings = check(self.folder)
        if self.format == "json":
            terminal.write_json([asdict(finding) for finding in findings])
        elif findings:
            shown = ("protocol", "fits", "layout", "references", "queries", "unanswerable", "missing")
            terminal.write_table(
                _table(shown, ([_cell(getattr(finding, name)) for name in shown] for finding in findings))
            )
        if not findings:
            from salad.datasets.protocols import LAYOUTS

            known = "; ".join(f"{layout.name} ({layout.what})" for layout in LAYOUTS.values())
            terminal.say(f"{self.folder} is in no layout known here: {known}")
        # A script that is about to evaluate wants to know whether it can, not whether there is anything at all.
        return terminal.FOUND if any(finding.fits for finding in findings) else terminal.NOTHING


@dataclass(frozen=True)
class DatasetsCommand:
    """See which protocols there are, and what a folder is."""

    command: Annotated[ListProtocols, subcommand("list")] | Annotated[CheckFolder, subcommand("check")]

    def run(self) -> int:
        """Pass on."""
        return self.command.run()


def _described(protocol: Protocol) -> dict[str, Any]:
    """A protocol as JSON has it; people see the same but for `about`."""
    return {
        "protocol": protocol.name,
        "references": protocol.references,
        "queries": protocol.queries,
        "about": protocol.about,
        "right when": "as your options say" if protocol.yours else str(protocol.rule),
        "unanswerable": protocol.unanswerable,
        "layouts": list(protocol.layouts),
        "get": protocol.get,
        "licence": protocol.licence,
    }


def _cells(row: dict[str, Any], shown: Iterable[str]) -> list[str]:
    """A protocol's cells; a published number that is round says so."""
    cells = {name: _cell(row[name]) for name in shown}
    if row["about"]:
        # Published as a round number, so no count of a folder is held against it.
        cells["references"] = f"about {cells['references']}"
    return list(cells.values())


def _table(names: Iterable[str], rows: Iterable[list[str]]) -> Any:
    from rich.table import Table

    table = Table(*names, box=None, pad_edge=False, header_style="bold")
    for row in rows:
        table.add_row(*(terminal.escaped(cell) for cell in row))
    return table


def _cell(value: Any) -> str:
    if isinstance(value, bool):  # first, since a bool is an int as well
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, list | tuple):
        return "; ".join(map(str, value))
    return "-" if value is None else str(value)  # an empty cell would look as if something were missing
