"""Files that `salad locate` writes beside its answer: copies with their position, and a track."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from salad.cli import maps, shell
from salad.errors import PhotoError, SaladError
from salad.wholefile import write_whole

if TYPE_CHECKING:
    from salad.place import Answer


def check_folder(folder: Path, photos: Sequence[Path]) -> None:
    """Make sure, before any work, that copies in `folder` cannot lie among the photos they are made of.

    Raises:
        SaladError: It is the folder of one of the photos, or no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise SaladError(f"--write-exif {folder} is a file: name a folder")
    home = os.path.realpath(folder)
    for photo in photos:
        if os.path.realpath(photo.parent) == home or os.path.dirname(os.path.realpath(photo)) == home:  # noqa: PTH120  # realpath's
            raise SaladError(
                f"--write-exif {folder} is the folder of {photo.name}, and originals are never touched: "
                "name another folder"
            )


def check_track(track: Path) -> None:
    """Make sure, before any work, that a track can be written and takes no photo's place.

    Raises:
        SaladError: Its name does not end in .gpx, or there is no folder for it.
    """
    if track.suffix.lower() != ".gpx":
        raise SaladError(f"--gpx {track} is no name for a track: end it in .gpx")
    if track.is_dir() or not track.parent.is_dir():
        raise SaladError(f"--gpx {track} cannot be written: name a file in a folder that is there")


def write_copies(folder: Path, answers: Sequence[Answer]) -> None:
    """Copy each photo that was located into `folder` with its position; say what could not be copied."""
    from salad.exifcopy import copy_with_position

    folder.mkdir(parents=True, exist_ok=True)
    written = 0
    for answer in answers:
        if answer.place is None:
            continue
        place, copy = answer.place, folder / answer.query.name
        try:
            copy_with_position(answer.query, copy, place.where, within_m=place.radius_m)
            written += 1
        except PhotoError as error:
            shell.say(str(error))
    shell.say(f"{folder}: {written} copies written, with their position")


def write_track(track: Path, answers: Sequence[Answer]) -> None:
    """Write the places found as a GPX track, whole or not at all; one of that name is replaced.

    Raises:
        OSError: If it cannot be written.
    """
    from salad.photos import read_photo

    times = [read_photo(answer.query).time for answer in answers]
    undated = sum(time is None for answer, time in zip(answers, times, strict=True) if answer.place)
    if undated:
        shell.say(f"{track}: {undated} photos do not know their time, so the track is in the order given")
    write_whole(track, maps.as_gpx(answers, times).encode())
