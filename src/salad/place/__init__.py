"""From matches to a place."""

from salad.place.locating import Answer, locate, locate_many
from salad.place.voting import Place, vote

__all__ = ["Answer", "Place", "locate", "locate_many", "vote"]
