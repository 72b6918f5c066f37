"""The command line: `salad --help`.

Little is imported before it is ready to be stopped: whoever presses Ctrl-C in its first moments gets a sentence too.
"""

from __future__ import annotations

import sys
from importlib import import_module

from salad.cli import stopping

TYPE_CHECKING = False  # typing takes longer to load than all of this
if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

COMMANDS = {  # in the order of `salad --help`: the file in `salad.cli` and the dataclass in it
    "index": "index_command:IndexCommand",
    "locate": "locate_command:LocateCommand",
    "info": "info_command:InfoCommand",
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
    stopping.listen()
    try:
        from salad.cli import terminal

        terminal.settle_streams()
        code = run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt as stop:  # as early as that; or again, while what was to be done upon the first was done
        code, sentence = stopping.told(stop)
        print(f"salad: {sentence}", file=sys.stderr)  # noqa: T201  # `terminal` may not be there yet
    stopping.leave()
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Run one command; its exit code."""
    from salad.cli import terminal
    from salad.errors import MissingExtraError, SaladError

    try:
        return _obeyed(arguments)
    except BrokenPipeError:  # whoever read our output has seen enough: `salad locate ... | head`
        return terminal.FOUND
    except BaseException as error:
        stop = stopping.stopped_by(error)
        if isinstance(error, SaladError) and not (stop and isinstance(error, MissingExtraError)):
            terminal.say(f"salad: {error}")
        elif isinstance(error, OSError):
            terminal.say(f"salad: {terminal.of_file(error)}")
        elif isinstance(error, MemoryError) and not stop:
            terminal.say("salad: this takes more memory than there is: ask for less at a time, or of smaller photos")
        elif isinstance(error, RecursionError) and not stop:
            terminal.say("salad: a folder or a file is nested too deeply for this: move it further up")
        elif not stop:
            raise
        if stop is None:
            return terminal.BAD_INPUT
        code, sentence = stopping.told(stop)
        terminal.say(f"salad: {sentence}")
        return code


def _obeyed(arguments: Sequence[str]) -> int:
    """Run one command; its exit code, or what went wrong."""
    from salad._version import __version__
    from salad.cli import terminal
    from salad.errors import SaladError

    first = arguments[0] if arguments else ""
    if list(arguments) in (["--version"], ["-V"]):
        terminal.write(f"salad {__version__}")
        return terminal.FOUND
    if not first.startswith("-") and first not in ("", *COMMANDS):
        from difflib import get_close_matches

        meant = get_close_matches(first, COMMANDS, n=1)
        hint = f"did you mean '{meant[0]}'?" if meant else "'salad --help' lists them"
        raise SaladError(f"there is no command {first!r}: {hint}")
    try:
        with terminal.results():  # help is one
            command = parsed(arguments)
    except SystemExit as left:  # behind help, and behind what makes no sense
        if left.code in (0, None) and first in COMMANDS:
            from salad.cli.examples import EXAMPLES

            terminal.write("\n".join(["examples:", *(f"  {line}" for line in EXAMPLES[first])]))
        return left.code if isinstance(left.code, int) else terminal.FOUND
    from salad.cli.arguments import check_numbers  # it loads the parser, which `--version` has no need of

    check_numbers(command)
    code: int = command.run()
    return code


def parsed(arguments: Sequence[str]) -> Any:
    """The command that arguments ask for, its fields their options; leaves with a sentence where they make no sense."""
    import operator
    from dataclasses import make_dataclass
    from functools import reduce
    from typing import Annotated

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
    from dataclasses import make_dataclass

    return make_dataclass(name, (), namespace={"__doc__": told})
