"""What an attack is: a thing that a stranger made, and the right answer to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from attack.outside import Scene

Answer = Literal["refused", "told", "harmless"]
"""What is right, besides what is right for all: that nothing outside changes, that every command ends in good time and
with exit code 0, 1 or 2, and that whatever it says is sentences.

    refused     exit code 2, the thing named, and not a byte of it changed
    told        `salad verify` names it and exits with 1; whatever else is done may go on without it
    harmless    whatever the command makes of it
"""
Command = tuple[str, ...]
"""Arguments of `salad`, in which `{given}`, `{outside}`, `{work}`, `{photos}` and `{index}` stand for the scene's."""


@dataclass(frozen=True)
class Attack:
    """A hostile thing.

    Attributes:
        name: What it is, in a few words.
        make: Puts it into the scene's folder `given`.
        right: The right answer.
        names: What a sentence must name.
        commands: What it is given to, where that is not said of all of its kind.
        memory: Bytes that an answer may take at a time.
        real_models: Whether models are read, rather than faked.
        also: Looks at what a command left behind and says what is wrong with it.
        every: Whether the suite gives it to several commands, each of which comes to it by another way. Of all
            others the suite takes some, and one command in turn; tests/long takes all of all.
        long: Whether its answer takes so long, or so much room, that only tests/long waits for it.
    """

    name: str
    make: Callable[[Scene], object]
    right: Answer = "refused"
    names: str = ""
    commands: tuple[Command, ...] = ()
    memory: int = 1 << 30
    real_models: bool = False
    also: Callable[[Scene], list[str]] | None = None
    every: bool = False
    long: bool = False
