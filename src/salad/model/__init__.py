"""The model: photo -> tokens -> plan -> descriptor."""
