"""Many locates in one process: memory, open files and processes stay as they are after the first ones."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from attack.answers import an_arena, set_up

WATCHED = """
import gc, json, os, sys
from pathlib import Path

from salad.errors import PhotoError
from salad.index.index import Index
from salad.localize.locate import locate
from salad.models.fake import FakeDescriber

def now():
    gc.collect()
    with open("/proc/self/statm") as file:
        resident = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return {"resident": resident, "handles": len(os.listdir("/proc/self/fd")), "children": len(children)}

folder, broken, count, seen = sys.argv[1], sys.argv[2], int(sys.argv[3]), []
photos = sorted(Path(sys.argv[4]).glob("*.jpg"))
model = FakeDescriber(dim=256, name="salad-lite")
with Index.open(folder) as index:
    for number in range(count):
        locate(photos[number % len(photos)], index=index, model=model)
        if number % 10 == 0:
            try:
                locate(broken, index=index, model=model)
            except PhotoError:
                pass
            Index.open(folder).close()
        if number % (count // 10) == 0:
            seen.append(now())
    seen.append(now())
json.dump(seen, sys.stdout)
"""


def watched(tmp_path: Path, count: int) -> list[dict[str, Any]]:
    """What a process that locates so many times holds, at its beginning and ten times after."""
    with an_arena(tmp_path) as (_, scene):
        set_up(scene)
        broken = scene.work / "broken.jpg"
        broken.write_bytes((scene.photos / "0.jpg").read_bytes()[:700])
        command = [sys.executable, "-c", WATCHED, scene.index, broken, str(count), scene.photos]
        told = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
    seen: list[dict[str, Any]] = json.loads(told.stdout)
    return seen


def stays_flat(seen: list[dict[str, Any]], *, megabytes: float) -> None:
    """Fails where a process holds more at its end than when it had settled."""
    settled, last = seen[len(seen) // 2], seen[-1]
    assert last["handles"] <= settled["handles"], seen
    assert last["children"] <= settled["children"], seen
    assert last["resident"] - settled["resident"] < megabytes * 1e6, seen


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory and handles are read from Linux's /proc")
def test_a_hundred_locates_stay_flat(tmp_path: Path) -> None:
    stays_flat(watched(tmp_path, 100), megabytes=16)
