"""Photos with known places: benchmarks, training places, and a drawn town."""
