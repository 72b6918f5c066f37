"""The command line: `salad --help`."""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import make_dataclass
from functools import reduce
from importlib import import_module
from typing import Annotated, Any

from salad._version import __version__
from salad.cli import terminal
from salad.errors import SaladError

COMMANDS = {  # in the order of `salad --help`: the file in `salad.cli` and the dataclass in it
    "index": "index_command:IndexCommand",
    "locate": "locate_command:LocateCommand",
    "info": "index_maintenance:InfoCommand",
    "verify": "index_maintenance:VerifyCommand",
    "remove": "index_maintenance:RemoveCommand",
    "compact": "index_maintenance:CompactCommand",
    "compress": "compress_command:CompressCommand",
    "export": "index_maintenance:ExportCommand",
    "merge": "index_maintenance:MergeCommand",
    "evaluate": "evaluate_command:EvaluateCommand",
    "datasets": "datasets_command:DatasetsCommand",
    "weights": "weights_command:WeightsCommand",
    "quantize": "quantize_command:QuantizeCommand",
    "export-model": "export_model_command:ExportModelCommand",
    "places": "places_command:PlacesCommand",
    "train": "train_command:TrainCommand",
    "compare": "compare_command:CompareCommand",
    "demo": "demo_command:DemoCommand",
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
    command = parsed(arguments)
    try:
        code: int = command.run()
    except SaladError as error:
        terminal.say(f"salad: {error}")
        return terminal.BAD_INPUT
    except KeyboardInterrupt:
        terminal.say(
            "salad: interrupted; index, compress, train, compare and weights fetch go on where they stopped when run "
            "again"
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


def parsed(arguments: Sequence[str]) -> Any:
    """The command that arguments ask for, its fields their options; leaves with a sentence where they make no sense."""
    import tyro
    from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, subcommand

    # Of no file: the parser would read a whole one in search of what is said about this only field.
    nowhere = {"__module__": "builtins"}
    named = [Annotated[command, subcommand(name)] for name, command in commands_for(arguments).items()]
    choice: Any = reduce(operator.or_, named)
    asked: Any = tyro.cli(
        make_dataclass("Salad", [("command", choice)], namespace=nowhere),
        prog="salad",
        description="A photo goes in; the place it shows comes out.",
        args=list(arguments),
        # A field of a field, and what a subcommand is called, need no prefix: `--near`, not `--only.near`.
        config=(OmitArgPrefixes, OmitSubcommandPrefixes),
    )
    return asked.command


def command_class(name: str) -> Any:
    """The dataclass of a command."""
    file, _, within = COMMANDS[name].partition(":")
    return getattr(import_module(f"salad.cli.{file}"), within)


def commands_for(arguments: Sequence[str]) -> Mapping[str, Any]:
    """All commands by name, each as much of it as the parser needs for these arguments.

    A parser reads the source of a command for the help of its options, which takes longer than what most commands
    do. So whoever names a command first, as nearly everybody does, has the others stand there by name alone; and
    `salad --help`, which shows what each says of itself, by their words alone.
    """
    first = arguments[0] if arguments else ""
    if first in COMMANDS:
        return {name: command_class(name) if name == first else _stand_in(name, "") for name in COMMANDS}
    if first in ("", "-h", "--help"):
        return {name: _stand_in(name, command_class(name).__doc__) for name in COMMANDS}
    return {name: command_class(name) for name in COMMANDS}  # an option before its command, or a slip


def _stand_in(name: str, told: str) -> type:
    """A command without options."""
    return make_dataclass(name, (), namespace={"__doc__": told})
