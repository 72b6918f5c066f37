"""Where attacks run: the command line in a process of its own, which may hang, fill memory or be killed for it.

Run as a program, this file is that process: it has imported what commands need, and for each line it reads it forks
one that runs a command as `salad` would. So a command costs hundredths of a second, and what it does by itself at its
end (workers, what was not closed) is done too.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MEMORY = 4 << 30
"""Bytes of address space that an attacked command may have; who fills it fails before the machine does."""
SECONDS = 60.0
"""How long it may take before it is killed: many times what it is promised."""


@dataclass(frozen=True)
class Ran:
    """What a command did.

    Attributes:
        code: Its exit code; negative where a signal ended it.
        out: What it wrote to stdout.
        err: What it wrote to stderr.
        seconds: How long it took.
        resident: The most memory that it, or a process that it started, had at a time, in bytes.
        killed: Whether it was killed because it did not end.
    """

    code: int
    out: str
    err: str
    seconds: float
    resident: int
    killed: bool


class Arena:
    """Runs commands, one at a time.

    Args:
        home: A folder for what a command keeps of its own accord, such as caches.
    """

    def __init__(self, home: Path) -> None:
        self.home = home
        home.mkdir(parents=True, exist_ok=True)
        mine = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "OMP_NUM_THREADS": "1"}
        self.server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | mine | {"OPENBLAS_NUM_THREADS": "1"},
        )

    def run(
        self,
        *arguments: object,
        cwd: Path,
        real_models: bool = False,
        memory: int = MEMORY,
        longest_file: int | None = None,
        seconds: float = SECONDS,
    ) -> Ran:
        """Run `salad ARGUMENTS`.

        Args:
            arguments: As on a command line.
            cwd: The folder it runs in.
            real_models: Whether `--model` is read; else every model is a fake one.
            memory: Bytes of address space.
            longest_file: Bytes that a file may have, as on a disk that is full.
            seconds: How long it may take.
        """
        job = {
            "arguments": [os.fsencode(str(argument)).decode("latin-1") for argument in arguments],
            "cwd": str(cwd),
            "real_models": real_models,
            "memory": memory,
            "longest_file": longest_file,
            "seconds": seconds,
            "told": str(self.home / "told"),
        }
        return Ran(**self._ask(job))

    def mutate(self, reader: str, seeds: Sequence[int], *, folder: Path, seconds: float = SECONDS) -> list[str]:
        """Put mutated inputs to a reader of `mutations.READERS`, a sentence for each seed that it does not stand.

        Args:
            reader: Its name.
            seeds: One mutation each.
            folder: Where it finds what is mutated, and writes what it made of it.
            seconds: How long one may take.
        """
        left, said = list(seeds), []
        while left:
            job = {"mutate": reader, "seeds": left, "folder": str(folder), "cwd": str(folder), "memory": MEMORY}
            ended = Ran(**self._ask(job | {"seconds": seconds, "each": True, "told": str(self.home / "told")}))
            *done, last = ended.out.splitlines() or [str(left[0])]
            said += [f"{reader}: {line}" for line in done if " " in line]
            if ended.code == 0:
                said += [f"{reader}: {last}"] if " " in last else []
                break
            # It died of one: that is named, and the others go on.
            died = int(last.split()[0])
            said.append(f"{reader}: {died} {'hung' if ended.killed else f'ended it with {ended.code}'}: {ended.err}")
            left = left[left.index(died) + 1 :]
        return said

    def close(self) -> None:
        """End the process."""
        self.server.communicate()
        assert self.server.returncode == 0

    def _ask(self, job: dict[str, Any]) -> dict[str, Any]:
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        self.server.stdin.write(json.dumps(job) + "\n")
        self.server.stdin.flush()
        answer: dict[str, Any] = json.loads(self.server.stdout.readline())
        return answer


# --- the process that forks ------------------------------------------------------------------


def serve() -> None:
    """For each line of stdin, a job, run it in a fork and write what came of it."""
    import salad.cli.arguments
    import salad.cli.compress_command
    import salad.cli.index_command
    import salad.cli.index_maintenance
    import salad.cli.locate_command
    import salad.images.workers
    import salad.index.build
    import salad.index.transfer
    import salad.localize.locate  # noqa: F401  # what most commands import, once for all of them
    from salad.cli.main import parsed

    for line in ("info x", "verify x", "locate x --index x", "index x --to x", "compact x", "compress x", "evaluate"):
        parsed(line.split())  # so that what a parser keeps of a command is kept for all

    # Of its own, so that the streams of a fork are as new as those of any program.
    asked, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    while line := asked.readline():
        job = json.loads(line)
        began, told = time.monotonic(), job["told"]
        for ending in (".out", ".err"):
            Path(told + ending).write_bytes(b"")  # it may be killed before it opens them
        child = os.fork()
        if not child:
            enter(job)
            return  # as a command that has ended: what it started, it also ends
        code, resident, killed = watched(child, job)
        answer = {
            "code": os.waitstatus_to_exitcode(code),
            "out": Path(told + ".out").read_text("utf-8", "backslashreplace"),
            "err": Path(told + ".err").read_text("utf-8", "backslashreplace"),
            "seconds": time.monotonic() - began,
            "resident": resident,
            "killed": killed,
        }
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def watched(child: int, job: dict[str, Any]) -> tuple[int, int, bool]:
    """Wait until a fork has ended, or kill it: its status, its memory, and whether it was killed."""
    # Of many mutations each may take so long: whoever writes another line has a new beginning.
    out, seen, due = Path(job["told"] + ".out"), -1, time.monotonic() + job["seconds"]
    handle, killed = os.pidfd_open(child), False
    try:
        while not select.select([handle], [], [], max(0.0, min(1.0, due - time.monotonic())))[0] and not killed:
            if job.get("each") and (size := out.stat().st_size) != seen:
                seen, due = size, time.monotonic() + job["seconds"]
            killed = time.monotonic() > due
    finally:
        os.close(handle)
    # All that it started too: after its end nothing of it may run on.
    if killed:
        os.kill(child, signal.SIGKILL)  # by itself: it may not have come so far as to have a group
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    _, code, used = os.wait4(child, 0)
    return code, used.ru_maxrss << 10, killed


def enter(job: dict[str, Any]) -> None:
    """In the fork: be what the job asks for, and leave as that leaves."""
    os.setsid()
    for descriptor, name in ((0, os.devnull), (1, job["told"] + ".out"), (2, job["told"] + ".err")):
        opened = os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(opened, descriptor)
        os.close(opened)
    os.chdir(job["cwd"])
    resource.setrlimit(resource.RLIMIT_AS, (job["memory"], resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if job.get("longest_file") is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (job["longest_file"], resource.RLIM_INFINITY))
    if "mutate" in job:
        from attack import mutations

        mutations.put(job["mutate"], job["seeds"], Path(job["folder"]))
        return
    from salad.cli.main import main

    if not job["real_models"]:
        from salad.models import model_folder
        from salad.models.fake import FakeDescriber

        model_folder.load = lambda *_, **__: FakeDescriber(dim=256, name="salad-lite")  # type: ignore[assignment]
    main([os.fsdecode(argument.encode("latin-1")) for argument in job["arguments"]])


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    serve()
