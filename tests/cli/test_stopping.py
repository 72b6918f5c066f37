"""Ctrl-C and SIGTERM: one sentence and the shells' exit code wherever they come, and what was done is kept."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from salad.cli import stopping
from salad.cli.main import run
from salad.errors import MissingExtraError, StoreError
from salad.index.index import Index

pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows has no signals that a process sends to itself")

# Stops itself at the import with that number, counted from when the command line is ready to be stopped.
AT_AN_IMPORT = """
import os, sys
class Stopping:
    left = {at}
    def find_spec(self, name, *_):
        if sys.unraisablehook is not sys.__unraisablehook__:
            self.left -= 1
            if self.left == 0:
                os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Stopping())
from salad.cli.main import main
main()
"""
# Describes by a fake, which stops itself at the fourth photo.
AT_A_PHOTO = """
import os, sys
from salad.models import model_folder
from salad.models.fake import FakeDescriber
class Tired(FakeDescriber):
    calls = 0
    def describe(self, *arguments, **settings):
        Tired.calls += 1
        if Tired.calls == 4:
            os.kill(os.getpid(), {number})
        return super().describe(*arguments, **settings)
model_folder.load = lambda *_, **__: Tired(dim=64, name="salad-lite")
from salad.cli.main import main
main()
"""
# A callback that can raise nothing: what comes of an exception there, Python says itself and goes on.
IN_A_CALLBACK = """
import os, time
from dataclasses import dataclass
from salad.cli import main as commands
class Callback:
    def __del__(self):
        os.kill(os.getpid(), {number})
        time.sleep(0)
@dataclass
class Command:
    def run(self):
        Callback()
        for _ in range(1000):
            time.sleep(0.01)
        return 0
commands.parsed = lambda _: Command()
commands.main()
"""


def stopped(script: str, *arguments: object, **fields: object) -> subprocess.CompletedProcess[str]:
    """What comes of a script, which stops itself."""
    command = [sys.executable, "-c", script.format(**fields), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False, timeout=100)


def kept_its_manners(ran: subprocess.CompletedProcess[str], number: int) -> None:
    word = "terminated" if number == signal.SIGTERM else "interrupted"
    assert "Traceback" not in ran.stderr
    assert ran.returncode == 128 + number, ran.stderr
    assert ran.stderr.splitlines()[-1].startswith(f"salad: {word}; index, ")


def at_imports(photos: Any, to: Path, *, times: int, seed: int) -> None:
    chance = random.Random(seed)
    for at in (1, *(chance.randint(2, 400) for _ in range(times - 1))):  # `index` looks for some 500 modules
        number = chance.choice((signal.SIGINT, signal.SIGTERM))
        ran = stopped(AT_AN_IMPORT, "index", photos.references, "--to", to, at=at, number=int(number))
        kept_its_manners(ran, number)
        assert ran.stdout == ""


def test_it_may_come_while_the_rest_is_loaded(photos: Any, tmp_path: Path) -> None:
    at_imports(photos, tmp_path / "index", times=6, seed=0)


@pytest.mark.long
def test_it_may_come_at_any_import(photos: Any, tmp_path: Path) -> None:
    at_imports(photos, tmp_path / "index", times=100, seed=1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_was_described_is_committed(photos: Any, tmp_path: Path, number: int) -> None:
    arguments = ("index", photos.references, "--to", tmp_path / "index", "--batch-size", 1)
    ran = stopped(AT_A_PHOTO, *arguments, number=int(number))
    kept_its_manners(ran, number)
    assert "3 of 6 photos were done; it holds 3" in ran.stderr
    with Index.open(tmp_path / "index") as index:
        assert (len(index), index.verify()) == (3, [])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_comes_in_a_callback_comes_again(number: int) -> None:
    kept_its_manners(stopped(IN_A_CALLBACK, number=int(number)), number)


def test_an_interrupt_that_is_not_to_be_heard_is_not(tmp_path: Path) -> None:
    """As nohup and shells have it for what runs in the background."""
    script = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + AT_AN_IMPORT
    ran = stopped(script, "--version", at=1, number=int(signal.SIGINT))
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize("stop", [KeyboardInterrupt, stopping.Terminated])
def test_what_is_written_in_c_makes_another_error_of_it(
    stop: type[KeyboardInterrupt], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(*_: Any) -> None:
        try:
            raise stop
        except KeyboardInterrupt:
            try:
                raise ImportError("initialization failed")
            except ImportError as error:
                raise MissingExtraError("running it", "fast") from error

    monkeypatch.setattr(Index, "open", load)
    code, said = stopping.told(stop())
    assert run(["info", "x"]) == code
    assert capsys.readouterr().err == f"salad: {said}\n"


def test_what_fails_because_of_it_is_told_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def commit(*_: Any) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise StoreError("the disk is full")  # noqa: B904  # as a commit in a `finally` has it

    monkeypatch.setattr(Index, "open", commit)
    assert run(["info", "x"]) == stopping.INTERRUPTED
    told, last = capsys.readouterr().err.splitlines()
    assert told == "salad: the disk is full"
    assert last.startswith("salad: interrupted")


def test_a_fork_ends_as_it_always_did(tmp_path: Path) -> None:
    script = """
import json, os, signal, sys
from salad.cli import stopping
stopping.listen()
child = os.fork()
if not child:
    os.kill(os.getpid(), signal.SIGTERM)
    os._exit(0)
print(json.dumps(os.WTERMSIG(os.waitpid(child, 0)[1])))
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, encoding="utf-8", check=False)
    assert (json.loads(ran.stdout), ran.stderr) == (signal.SIGTERM, "")
