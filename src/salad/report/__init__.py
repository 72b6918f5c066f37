"""Pages to look at: an evaluation, and what the model saw."""

from salad._moved import keep_former_names

keep_former_names(__name__)
