"""Judging: how often the right place is among the first answers, and how sure that figure is."""

from salad.evaluation.judging import Terms, judged
from salad.evaluation.measuring import evaluate, evaluate_descriptors, evaluate_rankings, with_leaks
from salad.evaluation.ranking import Held, Ranked, nearest, rank
from salad.evaluation.recall import KS, recall_at
from salad.evaluation.result import Result, Verdict
from salad.evaluation.saving import as_csv, read_result, write_csv, write_result

__all__ = [
    "KS",
    "Held",
    "Ranked",
    "Result",
    "Terms",
    "Verdict",
    "as_csv",
    "evaluate",
    "evaluate_descriptors",
    "evaluate_rankings",
    "judged",
    "nearest",
    "rank",
    "read_result",
    "recall_at",
    "with_leaks",
    "write_csv",
    "write_result",
]
