"""MATLAB files: what SciPy writes comes out as SciPy reads it; what is damaged is a sentence."""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from salad.datasets import matlab
from salad.datasets.matlab import read_struct
from salad.errors import BenchmarkError

TOLD: dict[str, Any] = {
    "whichSet": "test",
    "dbImageFns": ["000/a.jpg", "000/bé.jpg", "c"],
    "utmDb": np.arange(6.0).reshape(2, 3),
    "posDistThr": 25.0,
    "inner": {"x": "y"},
}


def check(read: dict[str, Any]) -> None:
    assert list(read) == list(TOLD)
    assert read["whichSet"] == "test"
    assert read["dbImageFns"] == TOLD["dbImageFns"]
    assert np.array_equal(read["utmDb"], TOLD["utmDb"])
    assert read["posDistThr"].tolist() == [[25.0]]
    assert read["inner"] == {"x": "y"}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("packed", [False, True])
def test_both_orders_packed_or_not(tmp_path: Path, fakes: ModuleType, order: str, packed: bool) -> None:
    path = tmp_path / "a.mat"
    path.write_bytes(fakes.mat_file(TOLD, order=order, packed=packed))
    check(read_struct(path, "dbStruct"))


@pytest.mark.parametrize("packed", [False, True])
def test_as_scipy_writes_it(tmp_path: Path, packed: bool) -> None:
    cells = np.empty((3, 1), dtype=object)
    cells[:, 0] = TOLD["dbImageFns"]
    told = TOLD | {"dbImageFns": cells, "small": np.array([[1, 2]], dtype=np.uint8), "none": np.zeros((0, 0))}
    scipy.io.savemat(tmp_path / "a.mat", {"other": 3, "dbStruct": told}, do_compression=packed)
    read = read_struct(tmp_path / "a.mat", "dbStruct")
    assert read.pop("small").tolist() == [[1.0, 2.0]]
    assert read.pop("none").size == 0
    check(read)


def test_scipy_reads_our_fakes(tmp_path: Path, fakes: ModuleType) -> None:
    for order in "<>":
        read = scipy.io.loadmat(io.BytesIO(fakes.mat_file(TOLD, order=order)))["dbStruct"].item()
        assert read[0].item() == "test"
        assert [cell.item() for cell in read[1].ravel()] == TOLD["dbImageFns"]
        assert np.array_equal(read[2], TOLD["utmDb"])


def test_refusals(tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mat"
    with pytest.raises(BenchmarkError, match=r"a\.mat cannot be read"):
        read_struct(path, "dbStruct")
    path.write_bytes(b"MATLAB 7.3".ljust(200))
    with pytest.raises(BenchmarkError, match=r"version 5 .* how it is written"):
        read_struct(path, "dbStruct")
    path.write_bytes(fakes.mat_file(TOLD, name="other"))
    with pytest.raises(BenchmarkError, match="no structure called dbStruct"):
        read_struct(path, "dbStruct")
    path.write_bytes(fakes.mat_file([1.0]))
    with pytest.raises(BenchmarkError, match="no structure called dbStruct"):
        read_struct(path, "dbStruct")
    deep: Any = "x"
    for _ in range(20):
        deep = [deep]
    path.write_bytes(fakes.mat_file({"a": deep}))
    with pytest.raises(BenchmarkError, match="without end"):
        read_struct(path, "dbStruct")
    path.write_bytes(fakes.mat_file(TOLD, packed=True))
    monkeypatch.setattr(matlab, "_MOST", 64)
    with pytest.raises(BenchmarkError, match="unpacks to more"):
        read_struct(path, "dbStruct")


def test_a_small_file_does_not_fill_the_memory(
    tmp_path: Path, fakes: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Empty cells by the million, fields of no name, bytes that are eight times as long as numbers."""
    path = tmp_path / "a.mat"
    path.write_bytes(fakes.mat_file({"cells": ["x"] * 50, "metres": [1.0] * 50}, packed=True))
    for name, most, said in (("_ELEMENTS", 100, "more parts"), ("_COUNT", 60, "more numbers")):
        with monkeypatch.context() as patch:
            patch.setattr(matlab, name, most)
            with pytest.raises(BenchmarkError, match=said):
                read_struct(path, "dbStruct")
    assert set(read_struct(path, "dbStruct")) == {"cells", "metres"}


@pytest.mark.skipif(os.name != "posix", reason="pipes and files of holes are POSIX's")
def test_what_is_no_file_and_what_is_full_of_holes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "holes").touch()
    os.truncate(tmp_path / "holes", 1 << 40)
    for name in ("pipe", "holes"):
        with pytest.raises(BenchmarkError, match=r"cannot be read .*(no regular file|longer than)"):
            read_struct(tmp_path / name, "dbStruct")


def told(path: Path) -> str | None:
    """The sentence a file is refused with; anything else goes through."""
    try:
        read_struct(path, "dbStruct")
    except BenchmarkError as error:
        return str(error)
    return None


def test_what_is_not_read_is_passed_over(tmp_path: Path) -> None:
    told = {"a": 1.0, "odd": scipy.sparse.csc_matrix(np.eye(2)), "b": np.array([3], dtype=np.int16)}
    scipy.io.savemat(tmp_path / "a.mat", {"dbStruct": told})
    read = read_struct(tmp_path / "a.mat", "dbStruct")
    assert (read["odd"], read["b"].tolist()) == (None, [[3.0]])


@settings(max_examples=300)
@given(
    packed=st.booleans(),
    edits=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=5),
    cut=st.one_of(st.just(0), st.integers(0, 600)),
)
def test_damage_is_a_sentence(
    tmp_path_factory: pytest.TempPathFactory,
    fakes: ModuleType,
    packed: bool,
    edits: list[tuple[int, int]],
    cut: int,
) -> None:
    data = bytearray(fakes.mat_file(TOLD, packed=packed))
    for place, value in edits:
        data[place % len(data)] = value
    path = tmp_path_factory.mktemp("mat") / "a.mat"
    path.write_bytes(data[: len(data) - cut % len(data)])
    assert told(path) is None or "a.mat" in str(told(path))
