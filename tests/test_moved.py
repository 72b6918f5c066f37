"""Import paths of before: each gives the object of today, and says once where it is now."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

FORMER = {
    "salad.data.lazy": "PhotoList Ragged Strings headings positions",
    "salad.data.protocols": "PROTOCOLS LAYOUTS read",
    "salad.evaluation": "KS Result Terms Verdict as_csv evaluate evaluate_descriptors evaluate_rankings read_result "
    "with_leaks write_csv write_result",
    "salad.explain": "clusters_over dustbin_over match_strip share_of",
    "salad.index": "Compacted Filter Index IndexInfo Indexed Match index_photos",
    "salad.index.filters": "Filter",
    "salad.model.fake": "FakeDescriber",
    "salad.model.weights": "load read_folder write_calibration write_folder",
    "salad.photos": "MAX_PIXELS SUFFIXES Photo PhotoTable Position at_name find_photos identity open_rgb parse_at_name "
    "placed read_photo save_jpeg squeeze",
    "salad.place": "Answer Place locate locate_many vote",
    "salad.place.calibrating": "Bin Case Judged calibrate calibration_error judge log_loss reliability threshold",
    "salad.report": "draw_report write_report",
}
"""What README and docs showed of the modules of before, and what stood beside it in a package's `__all__`."""

IMPORT_ALL = """
import importlib, json, sys, warnings
import salad

def imported(module, name):
    space = {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        exec(compile(f"from {module} import {name}", "somebody.py", "exec"), space)
    (warning,) = caught
    new = str(warning.message).split(" is ")[1].split(" now")[0]
    home, _, there = new.rpartition(".")
    same = space[name] is getattr(importlib.import_module(home), there)
    return [f"{module}.{name}", warning.category.__name__, warning.filename, str(warning.message), new, same]

former = json.load(sys.stdin)
print(json.dumps([imported(module, name) for module, names in former.items() for name in names.split()]))
"""


def test_each_gives_the_object_of_today_and_one_warning() -> None:
    """In a process of its own, in which nothing was imported before."""
    ran = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL],
        input=json.dumps(FORMER),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    found = json.loads(ran.stdout)
    assert len(found) == sum(len(names.split()) for names in FORMER.values())
    for old, category, filename, message, new, same in found:
        assert (category, filename, same) == ("DeprecationWarning", "somebody.py", True), old
        assert message == f"{old} is {new} now; the old path goes with 0.2.0"
        assert new != old


def test_a_module_by_its_name_and_a_second_look() -> None:
    import salad.photos

    from salad.images.photo import read_photo

    with pytest.warns(DeprecationWarning, match=r"salad\.images\.photo\.read_photo"):
        assert salad.photos.read_photo is read_photo
    assert salad.photos.read_photo is read_photo  # a warning would be an error here


def test_the_file_of_evaluate_and_the_function_of_before_do_not_hide_each_other() -> None:
    import salad
    from salad.evaluation import evaluate_benchmark

    with pytest.warns(DeprecationWarning, match=r"salad\.evaluation\.evaluate_benchmark\.evaluate"):
        exec("from salad.evaluation import evaluate", space := {})
    assert space["evaluate"] is evaluate_benchmark.evaluate is salad.evaluate


@pytest.mark.parametrize("module", ["salad.photos", "salad.index", "salad.model", "salad.model.fake"])
def test_what_never_was_is_not_there(module: str) -> None:
    with pytest.raises(ImportError, match="cannot import name 'sald'"):
        exec(f"from {module} import sald")
    with pytest.raises(ModuleNotFoundError):
        exec("import salad.sald")
