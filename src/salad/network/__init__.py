"""SALAD as torch modules: photo -> tokens -> plan -> descriptor; for training, converting and checking."""
