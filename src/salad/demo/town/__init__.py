"""A drawn town with true coordinates."""
