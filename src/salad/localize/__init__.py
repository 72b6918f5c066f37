"""From matches to a place."""
