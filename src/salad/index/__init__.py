"""The index: photos and their descriptors on disk, searched exactly."""

from salad.index.build import Indexed, index_photos
from salad.index.compact import Compacted
from salad.index.filters import Filter
from salad.index.health import IndexInfo
from salad.index.search import Match, Searcher
from salad.index.store import Index

__all__ = ["Compacted", "Filter", "Index", "IndexInfo", "Indexed", "Match", "Searcher", "index_photos"]
