"""Pages to look at: an evaluation, and what the model saw."""
