"""A model in use: photos -> descriptors; folders on disk, the zoo, fetching."""
