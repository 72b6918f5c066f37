"""Judging: how often the right place is among the first answers."""

from salad.evaluation.recall import KS, Result, evaluate, rank, recall_at

__all__ = ["KS", "Result", "evaluate", "rank", "recall_at"]
