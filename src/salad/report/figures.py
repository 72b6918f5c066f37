"""The page's figures: what was judged and how, every figure with its interval, groups, what a reader should know."""

from __future__ import annotations

from collections.abc import Iterable

from salad._version import __version__
from salad.evaluation.bootstrap import Interval
from salad.evaluation.result import QueryResult, Result
from salad.geo import told_metres
from salad.report.choosing import OUTCOMES, counts
from salad.report.words import ends, exact, several, shown, whole

TOGETHER = {
    "query": "each query by itself",
    "group": "groups of queries together",
    "block": "stretches of the drive together",
}
LISTED = 20  # leaks and groups that are named
Row = tuple[str, str, str, str]


def facts(result: Result) -> str:
    """What a reader must know before the figures."""
    rule = "left out of recall" if result.unanswerable_rule == "drop" else "counted as misses"
    told = {
        "protocol": shown(result.protocol),
        "queries": whole(result.queries),
        "references": whole(result.references),
        "without a right reference": whole(result.unanswerable)
        + (f", {rule}" if result.unanswerable else ""),
        "model": shown(result.model),
    }
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in told.items())


def tallies(result: Result) -> str:
    """How many queries came to what: the map's key."""
    said = {"right": "right", "wrong": "wrong", "unanswerable": "without a right reference"}
    found = counts(result.per_query)
    return "".join(
        f'<span class="{kind}"><span class="glyph" aria-hidden="true"></span>'
        f'<b class="count-{kind}">{found[kind]:,}</b> {said[kind]}</span>'
        for kind in OUTCOMES
    )


def table(result: Result) -> str:
    """A line a figure."""
    lines = "".join(
        f'<tr><th scope="row">{name}</th><td>{figure}</td><td class="between">{between}</td>'
        f'<td class="bar">{bar}</td></tr>'
        for name, figure, between, bar in _rows(result)
    )
    return (
        '<table><thead><tr><th scope="col">Measure</th><th scope="col">Found</th><th scope="col">95 % interval</th>'
        f'<th scope="col" class="bar">0 to 100 %</th></tr></thead><tbody>{lines}</tbody></table>'
    )


def _rows(result: Result) -> Iterable[Row]:
    for k, percent in result.recall.items():
        yield _share(f"R@{k}", percent, result.intervals.get(k))
    if (curve := result.precision_recall) is not None:
        yield _share("area under precision-recall", curve.area, curve.area_interval)
        least = "" if curve.threshold is None else f" <small>from score {curve.threshold:.3f} on</small>"
        yield _share(f"recall at 100 % precision{least}", curve.recall_at_full_precision, curve.full_interval)
    if (far := result.distances) is not None:
        middle = f'<data value="{far.median!r}">{told_metres(far.median)}</data>'
        sides = far.median_interval.low, far.median_interval.high
        between = " to ".join(f'<data value="{end!r}">{told_metres(end)}</data>' for end in sides)
        yield f"median error <small>of {whole(far.known)} queries</small>", middle, between, ""
        for metres, share in far.within.items():
            yield _share(f"within {metres} m", share, far.within_intervals.get(metres))


def _share(name: str, percent: float, interval: Interval | None) -> Row:
    return name, exact(percent, " %"), "" if interval is None else ends(interval), _bar(percent, interval)


def _bar(percent: float, interval: Interval | None) -> str:
    """Where a share lies between 0 and 100, with its interval."""
    sure = "" if interval is None else f'<path class="sure" d="M{interval.low:.1f} 7H{interval.high:.1f}"/>'
    return (
        '<svg viewBox="-4 0 108 14" aria-hidden="true"><path class="grid" d="M0 2v10M50 2v10M100 2v10M0 7h100"/>'
        f'{sure}<circle cx="{percent:.1f}" cy="7" r="3.4"/></svg>'
    )


def drawn(result: Result) -> str:
    """How sure the figures are, in a sentence."""
    told = result.drawn
    if not told:
        return ""
    by = TOGETHER.get(str(told.get("by")), "queries")
    length = f" of {told.get('length')} frames" if told.get("by") == "block" else ""
    return (
        f"The truth lies in the interval 95 times in 100. Queries were drawn again {told.get('times')} times, {by}: "
        f"{told.get('units')} units{length}, seed {told.get('seed')}."
    )


def groups(result: Result) -> str:
    """R@1 of each group, the worst first; nothing where no groups are known."""
    some: dict[str, list[QueryResult]] = {}
    for one in result.per_query:
        if one.group is not None and result.counts(one):
            some.setdefault(one.group, []).append(one)
    if len(some) < 2:
        return ""
    shares = {name: 100 * sum(one.hit(1) for one in those) / len(those) for name, those in some.items()}
    worst = sorted(some, key=lambda name: (shares[name], -len(some[name]), name))
    lines = "".join(
        f'<tr><th scope="row">{shown(name)}</th><td>{whole(len(some[name]))}</td><td>{exact(shares[name], " %")}</td>'
        f'<td class="bar">{_bar(shares[name], None)}</td></tr>'
        for name in worst[:LISTED]
    )
    more = f"<p>and {several(len(worst) - LISTED, 'better group')}</p>" if len(worst) > LISTED else ""
    return (
        '<section class="card groups"><h2>Groups, the worst first</h2><table><thead><tr><th scope="col">Group</th>'
        '<th scope="col">Queries</th><th scope="col">R@1</th><th scope="col" class="bar">0 to 100 %</th></tr></thead>'
        f"<tbody>{lines}</tbody></table>{more}</section>"
    )


def notes(result: Result, more: Iterable[str] = ()) -> str:
    """Sentences a reader of the figures should see, and the photos that are in both sides."""
    told = [*result.notes, *more]
    if result.leaks is not None:
        told.append(f"{several(len(result.leaks), 'photo is', 'photos are')} in both sides.")
        told += [
            f"{leak.query_path} is the same {leak.kind} as {leak.reference_path}."
            for leak in result.leaks[:LISTED]
        ]
        if len(result.leaks) > LISTED:
            told.append(f"So are {len(result.leaks) - LISTED:,} more.")
    return "<ul>" + "".join(f"<li>{shown(note)}</li>" for note in told) + "</ul>" if told else ""


def colophon(result: Result) -> str:
    """What made the page."""
    print_ = f" <code>{shown(result.fingerprint)}</code>" if result.fingerprint else ""
    return (
        f"salad {__version__}, {shown(result.model)}{print_}; "
        f"{exact(result.seconds, ' s')} for describing and ranking. This page is one file and fetches nothing."
    )
