"""Visual place recognition that people can use: a photo goes in, the place it shows comes out.

    model = salad.load("salad-lite")
    index = salad.Index.open("city.index")
    answer = salad.locate("photo.jpg", index=index, model=model)

Names are brought in when they are first used, so importing the package is instant and loads no torch.
"""

from __future__ import annotations

from importlib import import_module

from salad._moved import find_former_modules
from salad._version import __version__

TYPE_CHECKING = False  # typing takes longer to load than all of this
if TYPE_CHECKING:
    from typing import Any

    from salad.errors import SaladError
    from salad.evaluation.evaluate_benchmark import evaluate
    from salad.geo import GeoPoint
    from salad.images.photo import Photo
    from salad.index.build import index_photos
    from salad.index.index import Index, Match
    from salad.localize.locate import Answer, locate, locate_many
    from salad.localize.voting import Place
    from salad.models.describer import Describer
    from salad.models.model_folder import load

_HOMES = {
    "Answer": "salad.localize.locate",
    "Describer": "salad.models.describer",
    "GeoPoint": "salad.geo",
    "Index": "salad.index.index",
    "Match": "salad.index.index",
    "Photo": "salad.images.photo",
    "Place": "salad.localize.voting",
    "SaladError": "salad.errors",
    "evaluate": "salad.evaluation.evaluate_benchmark",
    "index_photos": "salad.index.build",
    "load": "salad.models.model_folder",
    "locate": "salad.localize.locate",
    "locate_many": "salad.localize.locate",
}

__all__ = [
    "Answer",
    "Describer",
    "GeoPoint",
    "Index",
    "Match",
    "Photo",
    "Place",
    "SaladError",
    "__version__",
    "evaluate",
    "index_photos",
    "load",
    "locate",
    "locate_many",
]

find_former_modules()


def __getattr__(name: str) -> Any:
    """Bring a public name in from its room."""
    if name not in _HOMES:
        raise AttributeError(f"module 'salad' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value  # a sub-package of the same name (locate, evaluate) must not shadow it
    return value


def __dir__() -> list[str]:
    return __all__
