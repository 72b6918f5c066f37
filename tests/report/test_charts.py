"""Curves between axes."""

from hypothesis import given, settings
from hypothesis import strategies as st

from salad.evaluation.bootstrap import Interval
from salad.report.charts import ABOVE, HIGH, LEFT, PERCENT, POINTS, TICKS, WIDE, Axis, Chart, ChartPoint

SHARE = Axis("x", 0, 100, TICKS)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(-10, 110), st.floats(-10, 110)), min_size=1, max_size=40))
def test_a_curve_stays_between_its_axes(corners: list[tuple[float, float]]) -> None:
    path = Chart("p", SHARE, PERCENT, sorted(corners)).curve
    points = [tuple(map(float, corner.split())) for corner in path.removeprefix("M").split("L")]
    assert all(LEFT <= across <= LEFT + WIDE for across, _ in points)
    assert all(ABOVE <= down <= ABOVE + HIGH for _, down in points)


def test_a_long_curve_keeps_both_ends_and_few_corners() -> None:
    line = [(n / 1000, n / 1000) for n in range(100_001)]
    corners = Chart("p", SHARE, PERCENT, line).curve.removeprefix("M").split("L")
    assert len(corners) <= POINTS
    assert (corners[0], corners[-1]) == (f"{LEFT:.1f} {ABOVE + HIGH:.1f}", f"{LEFT + WIDE:.1f} {ABOVE:.1f}")


def test_every_factor_is_as_long_on_a_logarithmic_axis() -> None:
    axis = Axis("m", 1, 10_000, (), log=True)
    assert [round(axis.at(value), 9) for value in (0.1, 1, 10, 100, 10_000, 1e9)] == [0, 0, 0.25, 0.5, 1, 1]


def test_a_figure_tells_its_interval() -> None:
    assert ChartPoint(1, 50, "R@1: 50.0 %").label == "R@1: 50.0 %"
    assert ChartPoint(1, 50, "R@1: 50.0 %", Interval(40, 60)).label == "R@1: 50.0 %, 95 %: 40.0 to 60.0"
