"""From matches to a place."""

from salad.locate.place import Answer, Place, locate, locate_many, vote

__all__ = ["Answer", "Place", "locate", "locate_many", "vote"]
