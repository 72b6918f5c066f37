"""salad."""
