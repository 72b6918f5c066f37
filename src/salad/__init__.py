"""Visual place recognition that people can use: a photo goes in, the place it shows comes out.

    model = salad.load("salad-lite")
    index = salad.Index.open("city.index")
    answer = salad.locate("photo.jpg", index=index, model=model)

Names are brought in when they are first used, so importing the package is instant and loads no torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from salad._version import __version__

if TYPE_CHECKING:
    from salad.errors import SaladError
    from salad.evaluation import evaluate
    from salad.geo import GeoPoint
    from salad.index import Index, Match
    from salad.index.build import index_photos
    from salad.model.describer import Describer
    from salad.model.weights import load
    from salad.photos import Photo
    from salad.place import Answer, Place, locate, locate_many

_HOMES = {
    "Answer": "salad.place",
    "Describer": "salad.model.describer",
    "GeoPoint": "salad.geo",
    "Index": "salad.index",
    "Match": "salad.index",
    "Photo": "salad.photos",
    "Place": "salad.place",
    "SaladError": "salad.errors",
    "evaluate": "salad.evaluation",
    "index_photos": "salad.index.build",
    "load": "salad.model.weights",
    "locate": "salad.place",
    "locate_many": "salad.place",
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


def __getattr__(name: str) -> Any:
    """Bring a public name in from its room."""
    if name not in _HOMES:
        raise AttributeError(f"module 'salad' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value  # a sub-package of the same name (locate, evaluate) must not shadow it
    return value


def __dir__() -> list[str]:
    return __all__
