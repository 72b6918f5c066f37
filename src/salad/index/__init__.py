"""The index: photos and their descriptors on disk."""
