"""An evaluation as one page: figures, curves, where it was right and wrong, and the mistakes with their photos."""

from salad.report.page import draw_report, write_report

__all__ = ["draw_report", "write_report"]
