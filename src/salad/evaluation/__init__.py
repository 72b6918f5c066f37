"""Judging: how often the right place is among the first answers, and how sure that figure is."""
