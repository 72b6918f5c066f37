"""What hypothesis draws of when a photo was taken and which way it looks."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

from hypothesis import strategies as st

zones = st.integers(-14 * 4, 14 * 4).map(lambda quarters: timezone(timedelta(minutes=15 * quarters)))
times = st.datetimes(datetime(1900, 1, 1), datetime(2100, 1, 1), timezones=st.one_of(st.none(), zones)).map(
    lambda t: t.replace(microsecond=0)
)
headings = st.floats(0, 360, exclude_max=True)
