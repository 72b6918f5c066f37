"""Recall over bytes a photo as a picture, a panel a model. SVG, for light and dark."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from salad.report.charts import Axis

WIDE, HIGH, LEFT, ABOVE, BELOW, GAP, LEGEND = 400, 260, 52, 64, 52, 30, 74  # in pixels
RESCORED = "100"  # the best so many by codes are scored exactly: filled marks

# Each way has a colour and a shape: nobody needs to tell colours apart. What has one size only is joined by no line.
SHAPES: Mapping[str, tuple[str, str]] = {
    "salad": ("a", "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z"),
    "FAISS IVF-PQ": ("b", "M-4.5 -4.5H4.5V4.5H-4.5Z"),
    "FAISS PCA, OPQ": ("c", "M0 -5.5L5.5 4.5H-5.5Z"),
    "FAISS HNSW": ("d", "M0 -6L6 0L0 6L-6 0Z"),
    "usearch i8": ("e", "M0 5.5L5.5 -4.5H-5.5Z"),
    "usearch b1": ("e", "M-6 -2H-2V-6H2V-2H6V2H2V6H-2V2H-6Z"),
}
COLOURS = {
    "a": ("#0b7480", "#4cc3cd"),
    "b": ("#a8431f", "#ff825c"),
    "c": ("#6f4a9c", "#c09ce8"),
    "d": ("#5c6063", "#a9aba7"),
    "e": ("#7d6200", "#dcb640"),
}


def chart(by_model: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """One SVG file of each model's figures, as `recall_per_byte` measures them."""
    width = LEFT + len(by_model) * (WIDE + LEFT + GAP)
    height = ABOVE + HIGH + BELOW + LEGEND
    light, dark = (
        "".join(f".{name} {{ stroke: {pair[which]}; --c: {pair[which]} }}" for name, pair in COLOURS.items())
        for which in (0, 1)
    )
    title = "Recall@10 against an exact search over the bytes that are kept in memory for a photo"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, sans-serif" font-size="12.5" role="img" aria-labelledby="title told">',
        f'<title id="title">{title}</title>',
        f'<desc id="told">{escape(told(by_model))}</desc>',
        "<style>.paper { fill: #fffefb } .ink { fill: #23272b } .soft { fill: #5c6063 } .hair { stroke: #dedacf } "
        f".filled {{ fill: var(--c) }} .hollow {{ fill: #fffefb }} path {{ fill: none; stroke-width: 1.7 }} {light}"
        "@media (prefers-color-scheme: dark) { .paper, .hollow { fill: #15191c } .ink { fill: #e9e6dd } "
        f".soft {{ fill: #a9aba7 }} .hair {{ stroke: #394044 }} {dark} }}</style>",
        f'<rect class="paper" width="{width}" height="{height}"/>',
        f'<text class="ink" x="{LEFT}" y="24" font-size="15">{title}</text>',
    ]
    for number, (model, figures) in enumerate(by_model.items()):
        parts += panel(model, figures, LEFT + number * (WIDE + LEFT + GAP))
    return "\n".join([*parts, *legend(), "</svg>", ""])


def panel(model: str, figures: Sequence[Mapping[str, Any]], left: float) -> list[str]:
    """One model's axes and marks."""
    across = Axis("bytes a photo", 24, 32_768, tuple((2.0**n, f"{2**n:,}") for n in range(5, 16, 2)), log=True)
    down = Axis("recall@10", 0, 1, tuple((n / 5, f"{n / 5:g}") for n in range(6)))
    bottom = ABOVE + HIGH
    parts = [f'<text class="ink" x="{left}" y="{ABOVE - 12}" font-weight="600">{escape(model)}</text>']
    for value, text in across.ticks:
        x = left + WIDE * across.at(value)
        parts.append(f'<path class="hair" d="M{x:.1f} {ABOVE}V{bottom}"/>')
        parts.append(f'<text class="soft" x="{x:.1f}" y="{bottom + 18}" text-anchor="middle">{text}</text>')
    for value, text in down.ticks:
        y = bottom - HIGH * down.at(value)
        parts.append(f'<path class="hair" d="M{left} {y:.1f}H{left + WIDE}"/>')
        parts.append(f'<text class="soft" x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
    parts.append(
        f'<text class="soft" x="{left + WIDE / 2}" y="{bottom + 38}" text-anchor="middle">{across.name}</text>'
    )
    for way, (colour, shape) in SHAPES.items():
        for depth in ("0", RESCORED):
            marks = [
                (held(each), each["recall"][depth]["all"], each["setting"])
                for each in figures
                if each["way"] == way and depth in each["recall"]
            ]
            places = [(left + WIDE * across.at(size), bottom - HIGH * down.at(recall)) for size, recall, _ in marks]
            dashes = ' stroke-dasharray="5 4"' if depth == "0" else ""
            parts.append(
                f'<path class="{colour}"{dashes} d="M{"L".join(f"{x:.1f} {y:.1f}" for x, y in places)}"/>'
                if len(places) > 1
                else ""
            )
            for (x, y), (size, recall, setting) in zip(places, marks, strict=True):
                said = f"{way}, {setting}, {size:,.0f} bytes a photo, {how(depth)}: {recall:.3f}"
                kind = "hollow" if depth == "0" else "filled"
                parts.append(
                    f'<path class="{colour} {kind}" transform="translate({x:.1f} {y:.1f})" d="{shape}">'
                    f"<title>{escape(said)}</title></path>"
                )
    return [part for part in parts if part]


def legend() -> list[str]:
    """Which mark is which."""
    top, parts = ABOVE + HIGH + BELOW + 14, []
    for number, (way, (colour, shape)) in enumerate(SHAPES.items()):
        x, y = LEFT + 8 + 130 * (number % 3), top + 22 * (number // 3)
        parts.append(f'<path class="{colour} filled" transform="translate({x} {y})" d="{shape}"/>')
        parts.append(f'<text class="ink" x="{x + 12}" y="{y + 4}">{escape(way)}</text>')
    text = f"hollow: {how('0')}; filled: {how(RESCORED)}"
    parts.append(f'<text class="soft" x="{LEFT}" y="{top + 48}">{text}</text>')
    return parts


def how(depth: str) -> str:
    """What decides."""
    return "by the codes alone" if depth == "0" else f"the best {depth} by codes scored exactly"


def held(figure: Mapping[str, Any]) -> float:
    """Bytes kept for a photo, without those that all share."""
    return float(figure["bytes"]["code"] + figure["bytes"]["beside"])


def told(by_model: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The picture in words: for each model and way, the least and the most bytes, and what is found by them."""
    said = []
    for model, figures in by_model.items():
        for way in dict.fromkeys(each["way"] for each in figures):
            those = sorted((each for each in figures if each["way"] == way), key=held)
            ends = [those[0], those[-1]] if len(those) > 1 else those
            depth = max(those[0]["recall"], key=lambda depth: (depth == RESCORED, depth == "0"))
            figure = " to ".join(
                f"{each['recall'][depth]['all']:.3f} by {math.floor(held(each)):,} bytes" for each in ends
            )
            said.append(f"{model}, {way}, {how(depth)}: {figure}.")
    return " ".join(said)
