"""Photos with known places: benchmarks to judge by, places to learn from."""
