"""`salad compress`, and the codes that an index gets by itself once it is large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from salad.cli import terminal
from salad.cli.arguments import IndexFolder
from salad.errors import SaladError

if TYPE_CHECKING:
    from salad.index.index import Index

Size = Annotated[Literal[256, 128, 64] | None, arg(name="bytes", metavar="256|128|64", help_behavior_hint="")]


@dataclass(frozen=True)
class CompressCommand:
    """Give an index codes, by which a large one is searched in little time and memory; run again, it mends them."""

    index: IndexFolder
    size: Size = None
    """Bytes of codes a photo; as many as before, or else 256."""
    off: bool = False
    """Take the codes away, and make none until this command is run without --off."""

    def run(self) -> int:
        """Compress."""
        from salad.index.index import Index

        if self.off and self.size is not None:
            raise SaladError(f"--off takes all codes away: leave out --bytes {self.size}, or leave out --off")
        with Index.open(self.index) as index:
            if self.off:
                index.drop_codes()
                terminal.say(f"{self.index}: it has no codes any more, and all searches are exact")
            else:
                _compress(index, self.size)
        return terminal.FOUND


def keep_compressed(index: Index) -> None:
    """Give a large index codes, and one that has outgrown its codes new ones."""
    if index.wants_codes():
        _compress(index, None)


def _compress(index: Index, size: int | None) -> None:
    with terminal.progress("compressing") as bar:
        bar(0, None)  # to fit takes a while before the first code is written
        done = index.compress(size, progress=bar)
    how = "fitted anew" if done.fitted else f"{done.written} of them written"
    terminal.say(f"{index.folder}: {done.rows} photos have codes of {done.size} bytes, {how}")
