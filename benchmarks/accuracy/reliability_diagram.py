"""The picture of a calibration: how sure it was, and how often it was right. Used by `calibration.py`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from salad.localize.calibration import Predictions, reliability


def diagram(series: Sequence[tuple[str, str, Predictions]], to: Path) -> None:
    """Draw confidence against the share of right ones, a disc a step, its area the number of cases."""
    side, edge = 360, 56
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {side + 2 * edge} {side + 2 * edge}" '
        'font-family="sans-serif" font-size="13" fill="#334">',
        f'<rect width="{side + 2 * edge}" height="{side + 2 * edge}" fill="#fff"/>',
        f'<rect x="{edge}" y="{edge}" width="{side}" height="{side}" fill="none" stroke="#99a"/>',
        f'<path d="M{edge} {edge + side}L{edge + side} {edge}" stroke="#99a" stroke-dasharray="4 4"/>',
        f'<text x="{edge + side / 2}" y="{2 * edge + side - 14}" text-anchor="middle">confidence</text>',
        f'<text transform="translate(16 {edge + side / 2}) rotate(-90)" text-anchor="middle">share right</text>',
    ]
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = edge + tick * side, edge + side - tick * side
        parts.append(f'<text x="{x}" y="{edge + side + 18}" text-anchor="middle">{tick:g}</text>')
        parts.append(f'<text x="{edge - 8}" y="{y + 4}" text-anchor="end">{tick:g}</text>')
    for number, (name, colour, judged) in enumerate(series):
        parts.append(f'<text x="{edge + 14}" y="{edge - 30 + 18 * number}" fill="{colour}">● {name}</text>')
        for one in filter(None, reliability(judged)):
            x, y = edge + one.confidence * side, edge + side - one.right * side
            size = 2 + 40 * one.weight**0.5
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="{colour}" fill-opacity="0.55">'
                f"<title>{name}: {one.cases} cases, {one.confidence:.2f} sure, {one.right:.2f} right</title></circle>"
            )
    to.write_text("\n".join([*parts, "</svg>", ""]), encoding="utf-8")
