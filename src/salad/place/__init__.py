"""From matches to a place."""

from salad.place.voting import Answer, Place, locate, locate_many, vote

__all__ = ["Answer", "Place", "locate", "locate_many", "vote"]
