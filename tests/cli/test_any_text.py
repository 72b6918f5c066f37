"""Whatever text an option is given, a command ends with 0, 1 or 2, and never with a traceback."""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
from collections.abc import Iterator
from itertools import accumulate, product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from salad.cli.main import command_class, run

NUMBERS = (
    *("99999999999999999999", "-99999999999999999999", "2147483648", "4294967296", "-1", "0", "1", "1e400", "1e308"),
    *("-1e308", "5e-324", "nan", "-nan", "inf", "-inf", "1_0", "٣", "1" * 5000, "0x10", "1e5"),
)
TEXTS = (
    *("", " ", "-", "--", ".", "..", "~", "a" * 5000, "a/" * 1500 + "b", "\x1b[2J", "\n", "=1+1", "[/b]"),
    *("1,2", "91,0", "nan,nan", "inf,1e400", "1,2,3,4", "0001-01-01", "9999-12-31", "9999-12-31T23:59+00:00", "cuda"),
    *("10000-01-01", "2024-05-01T12:00:00+99:00", "frames:1e400", "radius:nan", "truth:", "meta", "C:\\"),
)
# No absolute path, and none out of the folder that it is run in: what is named is written.
ANY = st.sampled_from(NUMBERS + TEXTS) | st.text(
    st.characters(exclude_characters="\0/", exclude_categories=["Cs"]), max_size=30
)

LINES = {  # to get as far as a command can without an hour's work; not export-model: the fake has no weights
    "index": ["index", "QUERY", "--to", "new.index"],
    "locate": ["locate", "QUERY", "--index", "CITY"],
    "remove": ["remove", "QUERY", "--index", "CITY"],
    "compress": ["compress", "CITY"],
    "info": ["info", "CITY"],
    "export": ["export", "CITY", "--to", "out"],
    "evaluate": ["evaluate", "--references", "REFERENCES", "--queries", "QUERIES", "--radius", "25"],
    "places": ["places", "REFERENCES", "--to", "places.csv"],
    "train": ["train", "--data", "nothing", "--to", "run"],
    "compare": ["compare", "a.json", "b.json"],
    "quantize": ["quantize", "salad-lite", "--photos", "nothing", "--to", "made"],
}


def options(command: type[Any]) -> Iterator[str]:
    """The options of a command, and of the groups in it."""
    for field in dataclasses.fields(command):
        if dataclasses.is_dataclass(field.default_factory):
            yield from options(field.default_factory)
        else:
            yield "--" + field.name.strip("_").replace("_", "-")


@pytest.fixture
def words(city: Path, photos: Any, asked: Any) -> dict[str, str]:
    return {
        "CITY": str(city),
        "QUERY": str(photos.query[0]),
        "QUERIES": str(photos.queries),
        "REFERENCES": str(photos.references),
    }


def answered(line: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command line in this process, where a bug is an exception; what it said."""
    code = run(line)
    out, err = capsys.readouterr()
    assert code in (0, 1, 2), ascii((line, err))
    assert "Traceback" not in out + err
    assert "Errno" not in err
    assert err or code != 2
    return err


def try_any_text(command: str, words: dict[str, str], data: st.DataObject, capsys: pytest.CaptureFixture[str]) -> None:
    line = [words.get(word, word) for word in LINES[command]]
    for _ in range(data.draw(st.integers(1, 2))):
        line += [data.draw(st.sampled_from(sorted(options(command_class(command))))), data.draw(ANY)]
    answered(line, capsys)


same_folder = [HealthCheck.function_scoped_fixture]  # what one line wrote the next may find


@pytest.mark.parametrize("command", LINES)
@settings(max_examples=20, suppress_health_check=same_folder)
@given(data=st.data())
def test_any_text_for_any_option(command: str, words: Any, data: st.DataObject, capsys: Any) -> None:
    try_any_text(command, words, data, capsys)


@pytest.mark.long
@pytest.mark.parametrize("command", LINES)
@settings(max_examples=1000, suppress_health_check=same_folder)
@given(data=st.data())
def test_very_much_text_for_any_option(command: str, words: Any, data: st.DataObject, capsys: Any) -> None:
    try_any_text(command, words, data, capsys)


HUGE, ENDLESS = ("99999999999999999999", "-99999999999999999999"), ("nan", "inf", "-inf", "1e400")
COUNTS = (
    *("locate -k", "locate --threads", "index --batch-size", "index --threads", "evaluate --seed", "places --fewest"),
    *("quantize --seed", "train --steps", "compare --seeds"),
)
MEASURES = (
    *("locate --radius", "locate --within", "locate --min-confidence", "locate --heading", "evaluate --radius"),
    *("places --cell", "places --apart", "train --last"),
)


@pytest.mark.parametrize(("asking", "number"), [*product(COUNTS, HUGE + ENDLESS[:1]), *product(MEASURES, ENDLESS)])
def test_a_number_that_nobody_can_mean_is_refused(
    asking: str, number: str, words: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    command, option = asking.split()
    line = [words.get(word, word) for word in LINES[command]]
    told = answered([*line, option, number], capsys)
    assert option.strip("-") in told


@pytest.mark.parametrize("threads", ["0", "1001"])
def test_as_many_threads_as_no_machine_has_are_refused(
    threads: str, words: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"--threads {threads}" in answered(
        ["locate", words["QUERY"], "--index", words["CITY"], "--threads", threads], capsys
    )


@pytest.mark.parametrize("spec", ["a" * 5000, "a/" * 1500, "a" * 300 + "/b", "x\ny"])
def test_any_name_of_a_model_is_a_sentence(
    spec: str, photos: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for line in (
        ["index", str(photos.query[0]), "--to", "new", "--model", spec],
        ["weights", "info", spec],
        ["weights", "fetch", spec],
        ["export-model", spec, "--to", "model.onnx"],
    ):
        assert answered(line, capsys).count("\n") >= 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", ["/", "a" * 300, "a/" * 1500 + "b", "a/" * 3000 + "b"])
def test_any_folder_to_write_to_is_a_sentence(
    to: str, city: Path, photos: Any, asked: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """On Python 3.11 folders that deep cannot be made; later ones may do it."""
    for line in (
        ["index", str(photos.query[0]), "--to", to],
        ["export", str(city), "--to", to],
        ["locate", str(photos.query[0]), "--index", str(city), "--write-exif", to],
    ):
        answered(line, capsys)


def test_a_photo_may_lie_however_deep(cli: Any, asked: Any, photos: Any) -> None:
    # Not where tests lie: of folders left there by a kill, what takes those away would die in each session after.
    folders = list(accumulate([tempfile.mkdtemp(), *["a"] * 1200], os.path.join))
    for folder in folders[1:]:
        os.mkdir(folder)  # noqa: PTH102  # a Path of each would take longer than all else
    photo = shutil.copy(photos.reference[0], folders[-1])
    try:
        ran = cli("index", folders[0], "--to", "index")
        assert (ran.code, "1 photos added" in ran.err) == (0, True), ran.err
        assert cli("locate", folders[0], "--index", "index", "--format", "csv").code == 0
    finally:  # what takes away the folders of tests calls itself for each
        os.unlink(photo)  # noqa: PTH108
        for folder in reversed(folders):
            os.rmdir(folder)  # noqa: PTH106
