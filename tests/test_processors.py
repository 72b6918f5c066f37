"""How many threads where nobody says."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from salad import processors


def test_threads_are_as_many_as_processors_unless_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processors, "os", SimpleNamespace(environ={}, cpu_count=lambda: 3))
    assert processors.processors() == 3
    monkeypatch.setattr(processors, "os", SimpleNamespace(environ={}, sched_getaffinity=lambda _: {0, 5}))
    assert processors.processors() == 2
    for told, count in (("7", 7), ("0", 2), ("4,2", 2)):
        monkeypatch.setattr(processors.os, "environ", {"OMP_NUM_THREADS": told})
        assert processors.processors() == count
