"""Teaching a model: places -> batches -> augmented views -> loss -> weights."""
