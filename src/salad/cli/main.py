"""The command line: `salad --help`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import tyro
from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes

from salad._version import __version__
from salad.cli import (
    compare_command,
    datasets_command,
    demo_command,
    evaluate_command,
    index_command,
    index_maintenance,
    locate_command,
    places_command,
    terminal,
    train_command,
    weights_command,
)
from salad.errors import SaladError

COMMANDS: dict[str, Any] = {  # in the order of `salad --help`
    "index": index_command.IndexCommand,
    "locate": locate_command.LocateCommand,
    "info": index_maintenance.InfoCommand,
    "verify": index_maintenance.VerifyCommand,
    "remove": index_maintenance.RemoveCommand,
    "compact": index_maintenance.CompactCommand,
    "export": index_maintenance.ExportCommand,
    "merge": index_maintenance.MergeCommand,
    "evaluate": evaluate_command.EvaluateCommand,
    "datasets": datasets_command.DatasetsCommand,
    "weights": weights_command.WeightsCommand,
    "places": places_command.PlacesCommand,
    "train": train_command.TrainCommand,
    "compare": compare_command.CompareCommand,
    "demo": demo_command.DemoCommand,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and leave with its exit code: 0, 1 (nothing found), 2 (bad input)."""
    terminal.settle_streams()
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run one command; its exit code."""
    if list(arguments) == ["--version"]:
        terminal.write(f"salad {__version__}")
        return terminal.FOUND
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="salad",
        description="A photo goes in; the place it shows comes out.",
        args=list(arguments),
        # A field of a field, and what a subcommand is called, need no prefix: `--near`, not `--only.near`.
        config=(OmitArgPrefixes, OmitSubcommandPrefixes),
    )
    try:
        code: int = command.run()
    except SaladError as error:
        terminal.say(f"salad: {error}")
        return terminal.BAD_INPUT
    except KeyboardInterrupt:
        terminal.say(
            "salad: interrupted; index, train, compare and weights fetch go on where they stopped when run again"
        )
        return terminal.INTERRUPTED
    except BrokenPipeError:  # whoever read our output has seen enough: `salad locate ... | head`
        # Python writes out stdout once more as it leaves, and would complain of the pipe again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return terminal.FOUND
    except OSError as error:  # a full disk, a folder that may not be read
        terminal.say(f"salad: {error}")
        return terminal.BAD_INPUT
    return code
