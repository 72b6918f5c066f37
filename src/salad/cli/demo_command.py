"""The command that shows what this is about: `salad demo`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salad.cli import terminal


@dataclass(frozen=True)
class DemoCommand:
    """Draw a town, index its photos, locate others, and show it all on one page."""

    to: Path = Path("demo")
    """The folder for photos, index and page."""
    seed: int = 7
    """Decides the town."""

    def run(self) -> int:
        """Show what this is about."""
        from salad.demo.demo_result import table
        from salad.demo.run import run_demo

        with terminal.progress("demo") as bar:
            result = run_demo(self.to, seed=self.seed, say=terminal.say, progress=bar)
        terminal.write_table(table(result))
        terminal.write(f"look at it: {result.page.resolve()}")
        return terminal.FOUND
