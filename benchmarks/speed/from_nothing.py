"""How long a clone takes to the end of `bash scripts/demo`: an environment, the installation, a town, forty answers.

    python -m benchmarks.speed.from_nothing [CHECKOUT ...] [--rounds 1]

Each checkout is cloned anew in each round, and they take turns; ratios are to the first, of the best rounds. What pip
has fetched before comes from its cache, which makes all of them quicker than a first time. On a busy machine believe
the processors' time, which is that of all processes together.
"""

from __future__ import annotations

import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks.machine import conditions, in_a_line
from benchmarks.options import ROOT, benchmark_parser


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("checkouts", nargs="*", type=Path, default=[ROOT], metavar="CHECKOUT", help="default: this one")
    parser.add_argument("--rounds", type=int, default=1, help="default: %(default)s")
    asked = parser.parse_args()
    taken: dict[Path, list[tuple[float, float]]] = {checkout: [] for checkout in asked.checkouts}
    for _ in range(asked.rounds):
        for checkout, rounds in taken.items():
            rounds.append(demo_from_nothing(checkout))
    print(in_a_line(conditions(rounds=asked.rounds)))
    best = {checkout: [min(times) for times in zip(*rounds, strict=True)] for checkout, rounds in taken.items()}
    first = best[asked.checkouts[0]]
    for checkout, (clock, processor) in best.items():
        ratios = f"{clock / first[0]:.2f} and {processor / first[1]:.2f}"
        print(f"{checkout}: {clock:.0f} s by the clock, {processor:.0f} s of the processors; {ratios} of the first")


def demo_from_nothing(checkout: Path) -> tuple[float, float]:
    """Seconds by the clock, and of the processors."""
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "clone"
        subprocess.run(["git", "-c", "advice.detachedHead=false", "clone", "--quiet", checkout, clone], check=True)
        # As in a new shell: whatever environment this one runs in must lend it nothing.
        lent = ("PYTHONPATH", "VIRTUAL_ENV")
        alone = {name: value for name, value in os.environ.items() if name not in lent}
        began, spent = time.perf_counter(), _processor()
        subprocess.run(
            ["bash", clone / "scripts" / "demo"], cwd=clone, env=alone, stdout=subprocess.DEVNULL, check=True
        )
        return time.perf_counter() - began, _processor() - spent


def _processor() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
