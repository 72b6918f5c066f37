"""The index: photos and their descriptors on disk."""

from salad._moved import keep_former_names

keep_former_names(__name__)
