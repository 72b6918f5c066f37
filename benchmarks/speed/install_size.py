"""How much room an installation takes: new environments, what pip puts into each, and the largest packages of them.

    python -m benchmarks.speed.install_size [WHAT ...] [--largest 8]

WHAT is anything of salad that pip installs: this checkout with or without an extra, or another checkout. Ratios are to
the first. Sizes are those of the files in site-packages, pip's own and compiled bytecode included; versions are those
of `constraints.txt`. Everything is installed anew into a folder that goes again, which takes gigabytes for a while.
"""

from __future__ import annotations

import subprocess
import tempfile
import venv
from pathlib import Path

from benchmarks.machine import conditions, in_a_line
from benchmarks.options import ROOT, benchmark_parser

WHAT = (".", ".[torch]", ".[train]", ".[fast]")


def main() -> None:
    """Measure and print."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("what", nargs="*", default=list(WHAT), metavar="WHAT", help=f"default: {' '.join(WHAT)}")
    parser.add_argument("--largest", type=int, default=8, help="packages named of each; default: %(default)s")
    asked = parser.parse_args()
    print(in_a_line(conditions()))
    first = None
    for what in asked.what:
        parts = packages(what)
        total = sum(parts.values())
        first = first or total
        largest = sorted(parts, key=lambda name: parts[name], reverse=True)[: asked.largest]
        shown = ", ".join(f"{name} {parts[name] / 1e6:.0f}" for name in largest)
        print(f"{what:<12} {total / 1e6:7,.0f} MB  {total / first:5.2f}  of it {shown}")


def packages(what: str) -> dict[str, int]:
    """Bytes of everything that stands in site-packages once pip has installed `what` into a new environment."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = next(file for file in Path(folder).glob("*/python*") if file.parent.name in ("bin", "Scripts"))
        install = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", "constraints.txt", what)
        subprocess.run([python, *install], cwd=ROOT, check=True)
        sizes: dict[str, int] = {}
        for part in next(Path(folder).rglob("site-packages")).iterdir():
            name = part.name.removesuffix(".libs")  # shared libraries that a wheel brings stand beside it
            files = [part] if part.is_file() else [file for file in part.rglob("*") if file.is_file()]
            sizes[name] = sizes.get(name, 0) + sum(file.stat().st_size for file in files)
        return sizes


if __name__ == "__main__":
    main()
