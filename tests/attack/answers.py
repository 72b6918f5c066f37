"""Puts an attack to the command line, and says what is wrong with the answers."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import datetime
from pathlib import Path

import numpy as np

from attack.arena import SECONDS, Arena, Ran
from attack.attacks import Attack, Command
from attack.outside import Scene, differences, seen
from salad.geo import GeoPoint, shifted
from salad.images.exif import save_jpeg

PHOTOS = 8
INDEX = "{given}/city.index"
OF_INDEXES: tuple[Command, ...] = (
    ("info", INDEX),
    ("verify", INDEX),
    ("locate", "{photos}/1.jpg", "--index", INDEX),
    ("index", "{photos}/7.jpg", "{photos}", "--to", INDEX),
    ("compact", INDEX),
    ("info", INDEX, "--format", "json"),
    ("locate", "{photos}/1.jpg", "--index", INDEX, "--format", "geojson", "--exact", "--near", "48.1,11.5"),
    ("export", INDEX, "--to", "{work}/exported"),
    ("merge", "{work}/mine.index", INDEX),
    ("merge", INDEX, "{work}/mine.index"),
    ("index", "{photos}", "--to", INDEX, "--prune"),
    ("remove", "{photos}/1.jpg", "--index", INDEX),
    ("compress", INDEX),
    ("compress", INDEX, "--off"),
)
"""What anybody does with an index; `mine.index` is a sound one."""
SOME = 5
"""How many of them, the first, come in by another way each."""


@contextmanager
def an_arena(root: Path) -> Iterator[tuple[Arena, Scene]]:
    """Where attacks run, and a scene whose photos and index are there; its other folders are yet to be made."""
    arena = Arena(root / "home")
    (root / "photos").mkdir()
    for number in range(PHOTOS):
        squares = np.random.default_rng(number).integers(0, 256, (6, 6, 3), dtype=np.uint8)
        save_jpeg(
            np.kron(squares, np.ones((16, 16, 1), dtype=np.uint8)),
            root / "photos" / f"{number}.jpg",
            where=shifted(GeoPoint(48.1, 11.5), 200.0 * number, 0.0),
            heading=30.0 * number,
            time=datetime(2024, 5, 1 + number, 12),
        )
    for command in (
        ("index", "photos", "--to", "city.index"),
        ("remove", "photos/7.jpg", "--index", "city.index"),
        ("compress", "city.index", "--bytes", "64"),
    ):
        ran = arena.run(*command, cwd=root)
        assert ran.code == 0, ran
    names = {name: root / name for name in ("given", "outside", "work", "photos")}
    try:
        yield arena, Scene(**names, index=root / "city.index")
    finally:
        arena.close()


def set_up(scene: Scene) -> None:
    """Make all folders of a scene anew."""
    for folder in (scene.given, scene.outside, scene.work):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
    shutil.copytree(scene.index, scene.work / "mine.index")
    (scene.work / "queries").mkdir()
    for name in ("0.jpg", "1.jpg"):
        shutil.copy(scene.photos / name, scene.work / "queries" / name)
    shutil.copy(scene.photos / "0.jpg", scene.outside / "photo.jpg")
    (scene.outside / "note.txt").write_text("not yours\n")
    (scene.outside / "zeros.bin").write_bytes(bytes(2000) + b"the end")
    (scene.outside / "rows.f16").write_bytes(np.full((9, 256), 1 / 16, np.float16).tobytes())
    (scene.outside / "private").mkdir()
    (scene.outside / "private" / "letter.txt").write_text("dear reader\n")
    (scene.outside / "link").symlink_to("note.txt")
    with closing(sqlite3.connect(scene.outside / "other.sqlite")) as db:
        db.execute("CREATE TABLE mine (a)")
        db.execute("INSERT INTO mine VALUES (1)")
        db.commit()


def trouble(
    attack: Attack, scene: Scene, arena: Arena, *, only: int | None = None, seconds: float = SECONDS
) -> list[str]:
    """What is wrong with the answers to an attack, a line each.

    Args:
        attack: The attack.
        scene: Where; its folders are made anew.
        arena: What runs the commands.
        only: Which of the commands it is given to, by any number; all where not given.
        seconds: How long each may take.
    """
    wrong: list[str] = []
    places = {name: str(getattr(scene, name)) for name in Scene.__dataclass_fields__}
    commands = attack.commands or OF_INDEXES
    if only is not None:
        some = commands[:SOME]
        commands = some if attack.every else (some[only // 3 % len(some)],)
    for command in commands:
        set_up(scene)
        attack.make(scene)
        before = [seen(folder) for folder in (scene.outside, scene.photos, scene.given)]
        arguments = [argument.format(**places) for argument in command]
        ran = arena.run(*arguments, cwd=scene.work, real_models=attack.real_models, seconds=seconds)
        found = misbehaved(ran, attack, verifying=command[0] == "verify")
        found += attack.also(scene) if attack.also else []
        outside, photos, given = (seen(folder) for folder in (scene.outside, scene.photos, scene.given))
        found += [f"outside, {each}" for each in differences(before[0], outside)]
        found += [f"of the photos, {each}" for each in differences(before[1], photos)]
        if attack.right == "refused":
            found += [f"inside, {each}" for each in differences(before[2], given, times=False)]
        wrong += [f"{' '.join(command)}: {each}" for each in found]
        if ran.killed:  # the others need not wait as long
            break
    return wrong


def misbehaved(ran: Ran, attack: Attack, *, verifying: bool = False) -> list[str]:
    """What is wrong with an answer, a line each; `verify` tells what it found as its result."""
    said = ran.err + (ran.out if verifying else "")
    last, wrong = said[-300:], []
    if ran.killed:
        return ["it did not end"]
    if any(word in said for word in ("Traceback", "Exception ignored", "Warning:", "[Errno")):
        wrong.append(f"it says what no user can read: {last}")
    if ran.resident > attack.memory:
        wrong.append(f"it took {ran.resident >> 20} MB")
    if "\x1b" in said:
        wrong.append("what a terminal obeys is shown as it is")
    if len(said) > 100_000:
        wrong.append(f"it says {len(said)} characters")
    right = {"refused": (1, 2) if verifying else (2,), "told": (1, 2) if verifying else (0, 1, 2)}
    if ran.code not in right.get(attack.right, (0, 1, 2)):
        wrong.append(f"exit code {ran.code}: {last}")
    elif attack.names not in said and (attack.right == "refused" or (attack.right == "told" and verifying)):
        wrong.append(f"it does not name {attack.names}: {last}")
    return wrong
