"""Sequences kept in flat arrays behave as sequences."""

from __future__ import annotations

import numpy as np
import pytest

from salad.datasets.compact_lists import Ragged


def test_ragged_is_a_sequence_of_arrays() -> None:
    held = Ragged.of([np.array([3, 4]), np.array([], dtype=np.int64), np.array([5])])
    assert [rows.tolist() for rows in held] == [[3, 4], [], [5]]
    assert held[-1].tolist() == [5]
    assert [rows.tolist() for rows in held[1:]] == [[], [5]]
    assert held.lengths.tolist() == [2, 0, 1]
    with pytest.raises(IndexError):
        held[3]
    assert len(Ragged.of([])) == 0
