"""The public surface: `import salad` and the names it gives."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
from importlib.resources import files

import pytest

import salad

NAMES = {
    *("Answer", "Describer", "GeoPoint", "Index", "Match", "Photo", "Place", "SaladError", "__version__"),
    *("evaluate", "index_photos", "load", "locate", "locate_many"),
}


def test_the_names_are_these() -> None:
    assert set(salad.__all__) == NAMES
    assert len(salad.__all__) == len(NAMES)
    assert sorted(dir(salad)) == sorted(salad.__all__)


@pytest.mark.parametrize("name", sorted(NAMES - {"__version__"}))
def test_every_name_is_found_at_home(name: str) -> None:
    value = getattr(salad, name)
    assert value is getattr(importlib.import_module(salad._HOMES[name]), name)
    assert value.__doc__
    assert inspect.isclass(value) == name[0].isupper()


def test_functions_stay_functions_whatever_is_imported() -> None:
    """A room of the same name, imported first or last, must not take a name's place."""
    script = (
        "import importlib, inspect, salad\n"
        "names = ('evaluate', 'index_photos', 'load', 'locate', 'locate_many')\n"
        "for turn in range(2):\n"
        "    for name in names:\n"
        "        importlib.import_module(salad._HOMES[name])\n"
        "        assert inspect.isfunction(getattr(salad, name)), (turn, name)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")


def test_importing_loads_nothing_heavy() -> None:
    script = (
        "import sys, salad\n"
        "salad.__version__, dir(salad)\n"
        "heavy = {'torch', 'numpy', 'PIL', 'tyro', 'rich'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")


def test_a_star_import_gives_them_all() -> None:
    space: dict[str, object] = {}
    exec("from salad import *", space)
    assert set(space) >= NAMES


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'salad' has no attribute 'sald'"):
        salad.sald  # noqa: B018  # looking it up is what fails
    assert not hasattr(salad, "__wrapped__")


def test_the_package_is_typed() -> None:
    assert files("salad").joinpath("py.typed").is_file()
    assert salad.__version__.count(".") >= 2
