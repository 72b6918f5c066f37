"""Judging: how often the right place is among the first answers, and how sure that figure is."""

from salad._moved import keep_former_names

keep_former_names(__name__)
