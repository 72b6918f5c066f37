"""Import paths that README and docs showed before the rooms had their names of today: they work for one release more.

The two tables are all there is to know of them. Where a module is gone, a finder that stands last in `sys.meta_path`
gives an empty one in its place; where a package is still there but no longer holds a name, its `__init__` calls
`keep_former_names`. Either looks a name up when it is asked for, and warns. What has no successor
(`rank`, `recall_at`) is not here. To drop them all, delete this file, what calls it, and its test.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec

TYPE_CHECKING = False  # typing takes longer to load than all of this
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

DROPPED_IN = "0.2.0"
MOVED_MODULES = {  # with all they held
    "salad.data.lazy": "salad.datasets.compact_lists",
    "salad.data.protocols": "salad.datasets.protocols",
    "salad.explain": "salad.report.explain",
    "salad.index.filters": "salad.search.filters",
    "salad.model.fake": "salad.models.fake",
    "salad.model.weights": "salad.models.model_folder",
    "salad.photos": "salad.images.photo",
    "salad.place.calibrating": "salad.localize.calibration",
}
MOVED_NAMES = {  # by themselves, whatever the table above says of their module
    "salad.evaluation.KS": "salad.evaluation.metrics.KS",
    "salad.evaluation.Result": "salad.evaluation.result.Result",
    "salad.evaluation.Terms": "salad.evaluation.evaluate_benchmark.EvalSettings",
    "salad.evaluation.Verdict": "salad.evaluation.result.QueryResult",
    "salad.evaluation.as_csv": "salad.evaluation.result.as_csv",
    "salad.evaluation.evaluate": "salad.evaluation.evaluate_benchmark.evaluate",
    "salad.evaluation.evaluate_descriptors": "salad.evaluation.evaluate_benchmark.evaluate_descriptors",
    "salad.evaluation.evaluate_rankings": "salad.evaluation.evaluate_benchmark.evaluate_rankings",
    "salad.evaluation.read_result": "salad.evaluation.result.read_result",
    "salad.evaluation.with_leaks": "salad.evaluation.evaluate_benchmark.with_leaks",
    "salad.evaluation.write_csv": "salad.evaluation.result.write_csv",
    "salad.evaluation.write_result": "salad.evaluation.result.write_result",
    "salad.index.Compacted": "salad.index.compact.Compacted",
    "salad.index.Filter": "salad.search.filters.Filter",
    "salad.index.Index": "salad.index.index.Index",
    "salad.index.IndexInfo": "salad.index.verify.IndexInfo",
    "salad.index.Indexed": "salad.index.build.Indexed",
    "salad.index.Match": "salad.index.index.Match",
    "salad.index.index_photos": "salad.index.build.index_photos",
    "salad.photos.MAX_PIXELS": "salad.images.decode.MAX_PIXELS",
    "salad.photos.SUFFIXES": "salad.images.finding.SUFFIXES",
    "salad.photos.find_photos": "salad.images.finding.find_photos",
    "salad.photos.PhotoTable": "salad.images.photo_table.PhotoTable",
    "salad.photos.Position": "salad.images.metadata.Position",
    "salad.photos.at_name": "salad.images.at_names.at_name",
    "salad.photos.identity": "salad.images.photo.content_hash",
    "salad.photos.open_rgb": "salad.images.decode.open_rgb",
    "salad.photos.parse_at_name": "salad.images.at_names.parse_at_name",
    "salad.photos.save_jpeg": "salad.images.exif.save_jpeg",
    "salad.photos.squeeze": "salad.images.decode.squeeze",
    "salad.place.Answer": "salad.localize.locate.Answer",
    "salad.place.Place": "salad.localize.voting.Place",
    "salad.place.locate": "salad.localize.locate.locate",
    "salad.place.locate_many": "salad.localize.locate.locate_many",
    "salad.place.vote": "salad.localize.voting.vote",
    "salad.place.calibrating.Bin": "salad.localize.calibration.ReliabilityBin",
    "salad.place.calibrating.Judged": "salad.localize.calibration.Predictions",
    "salad.report.draw_report": "salad.report.evaluation_page.draw_report",
    "salad.report.write_report": "salad.report.evaluation_page.write_report",
}
_PACKAGES_GONE = ("salad.data", "salad.model", "salad.place")  # in which those modules lay


def find_former_modules() -> None:
    """Let modules that are gone be imported."""
    if _Finder not in sys.meta_path:
        sys.meta_path.append(_Finder)  # last, so that nothing which is there is looked for here


def keep_former_names(package: str) -> None:
    """Let a package give the names that it gave before."""
    vars(sys.modules[package])["__getattr__"] = _lookup_in(package)


class _Finder:
    """Finds the modules that are gone; its own loader too, since there is nothing to load."""

    @classmethod
    def find_spec(cls, name: str, *_: object) -> ModuleSpec | None:
        if name not in MOVED_MODULES and name not in _PACKAGES_GONE:
            return None
        # Loader by what it does: the base class in importlib.abc takes longer to import than all of this package.
        loader: Any = cls()
        return ModuleSpec(name, loader, is_package=name in _PACKAGES_GONE)

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave it to Python."""

    def exec_module(self, module: ModuleType) -> None:
        keep_former_names(module.__name__)


def _lookup_in(module: str) -> Callable[[str], Any]:
    """What Python calls for a name that a module does not hold."""

    def lookup(name: str) -> Any:
        old = f"{module}.{name}"
        new = MOVED_NAMES.get(old)
        if new is None and module in MOVED_MODULES and not name.startswith("_"):
            new = f"{MOVED_MODULES[module]}.{name}"
        if new is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        home, _, name_there = new.rpartition(".")
        value = getattr(import_module(home), name_there)
        import warnings  # only now: `import salad` stays instant

        told = f"{old} is {new} now; the old path goes with {DROPPED_IN}"
        warnings.warn(told, DeprecationWarning, stacklevel=2)
        # `from module import name` asks twice, and is warned of once: what was found is kept.
        setattr(sys.modules[module], name, value)
        return value

    return lookup
