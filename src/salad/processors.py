"""How many threads and processes are worth having where nobody says how many."""

from __future__ import annotations

import os


def processors() -> int:
    """Processors that this process may use, or as many as the environment's OMP_NUM_THREADS allows."""
    # The variable is OpenMP's, whose threads ours are not; but it is what people set to say how many they want.
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdecimal() and int(asked):
        return int(asked)
    may = getattr(os, "sched_getaffinity", None)
    return len(may(0)) if may else os.cpu_count() or 1
