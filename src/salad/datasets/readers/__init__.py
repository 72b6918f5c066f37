"""One reader for each way in which evaluation sets lie on disk."""
