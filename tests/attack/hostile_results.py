"""Results of evaluations that somebody made to be shown, and to be compared with one's own."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from typing import Any

from attack.attacks import Answer, Attack, Command
from attack.outside import Scene

SHOWN: tuple[Command, ...] = (
    ("evaluate", "--result", "{given}/r.json", "--report", "{work}/page.html", "--csv", "{work}/r.csv"),
)
BESIDE: tuple[Command, ...] = ((*SHOWN[0], "--references", "{given}/references", "--queries", "{given}/queries"),)
COMPARED: tuple[Command, ...] = (("compare", "{given}/r.json", "{given}/r.json"),)


def result(*, folders: tuple[str, str] = ("/nowhere", "/nowhere"), query: str = "q.jpg", reference: str = "r.jpg",
           **more: Any) -> dict[str, Any]:  # fmt: skip
    """A result of two queries, one of them wrong, whose photos are called that."""
    verdict = {"query": query, "positives": 1, "first_right": None, "matches": [0], "scores": [0.9], "right": 0,
               "metres": 900.0, "where": [48.1, 11.5], "group": None}  # fmt: skip
    right = verdict | {"query": "sound.jpg", "first_right": 1, "metres": 1.0}
    made = {
        "format": 1, "protocol": "within 25 m", "queries": 2, "references": 1, "unanswerable": 0,
        "recall": {"1": 50.0, "5": 50.0}, "model": "theirs", "seconds": 1.0, "benchmark": "theirs",
        "unanswerable_rule": "drop", "fingerprint": "", "drawn": {}, "intervals": {"1": [1.0, 90.0], "5": [1.0, 90.0]},
        "precision_recall": None, "metres": None, "leaks": None, "notes": [], "folders": list(folders),
        "digests": ["", ""], "known": {"0": [reference, [48.1, 11.5]]}, "verdicts": [verdict, right],
    }  # fmt: skip
    return made | more


def told(made: dict[str, Any] | Callable[[Scene], dict[str, Any]]) -> Callable[[Scene], None]:
    """A result in a file."""

    def make(scene: Scene) -> None:
        (scene.given / "r.json").write_text(json.dumps(made if isinstance(made, dict) else made(scene)))

    return make


def no_pictures(scene: Scene) -> list[str]:
    """What a page shows of files that lie outside of what was given: nothing."""
    page = scene.work / "page.html"
    if not page.exists():
        return []
    text = page.read_text()
    return [
        f"the page holds {what}" for what in ("data:image/jpeg", "data:image/png", "data:image/webp") if what in text
    ]


def leading_out() -> Iterator[Attack]:
    """Paths that climb out of their folders, or are absolute, or lead through links."""
    for what, name in {
        "climb": "../outside/photo.jpg",
        "climb far": "../" * 40 + "{outside}/photo.jpg",
        "are absolute": "{outside}/photo.jpg",
        "lead to a pipe": "{outside}/waits.jpg",
        "lead through a folder that is a link": "out/photo.jpg",
        "lead through a link": "link.jpg",
        "climb within": "x/../../../outside/photo.jpg",
        "are a folder": ".",
        "are too long": "a" * 5000 + ".jpg",
        "are written in percent": "..%2foutside%2fphoto.jpg",
        "hold a NUL": "\0.jpg",
    }.items():

        def make(scene: Scene, name: str = name) -> None:
            named = name.replace("{outside}", str(scene.outside))
            for side in ("references", "queries"):
                (scene.given / side).mkdir()
                (scene.given / side / "out").symlink_to(scene.outside)
                (scene.given / side / "link.jpg").symlink_to(scene.outside / "photo.jpg")
            os.mkfifo(scene.outside / "waits.jpg")
            made = result(folders=(str(scene.given), str(scene.given)), query=named, reference=named)
            (scene.given / "r.json").write_text(json.dumps(made))

        yield Attack(
            f"a result's photos {what}", make, "harmless", commands=SHOWN + BESIDE, also=no_pictures, every=True
        )
    for what, folder in {"the root": "/", "nothing": "", "outside": "{outside}", "a text with a NUL": "\0"}.items():

        def rooted(scene: Scene, folder: str = folder) -> None:
            named = folder.replace("{outside}", str(scene.outside))
            made = result(folders=(named, named), query="photo.jpg", reference=str(scene.outside / "photo.jpg")[1:])
            (scene.given / "r.json").write_text(json.dumps(made))

        yield Attack(f"a result's folders are {what}", rooted, "harmless", commands=SHOWN, also=no_pictures)


def unscripted(scene: Scene) -> list[str]:
    """Whether a page holds what a result would have run in it."""
    page = scene.work / "page.html"
    text = page.read_text() if page.exists() else ""
    return [f"the page holds {what}" for what in ("<script>alert", "<img src=x", 'href="javascript:') if what in text]


def lying() -> Iterator[Attack]:
    """Results that are none."""
    script = "<script>alert(1)</script><img src=x onerror=alert(1)>"
    for name in ("benchmark", "protocol", "model", "fingerprint"):
        yield given(f"{name} is a script", told(result() | {name: script}), "harmless", also=unscripted)
        yield given(f"{name} is a list", told(result() | {name: [1]}))
    names = told(result(query=script, reference=f"javascript:{script}", notes=[script, "\x1b[2J"]))
    yield given("names are scripts", names, "harmless", also=unscripted)
    for name, values in {
        "queries": (10**30, -1, True, "2", 3),
        "recall": ({"1": float("nan")}, {"x": 1.0}, {"1": 1e308}, [], {str(10**30): 5.0}, {"-1": 5.0}, None, 5),
        "intervals": ({"1": [float("nan"), 5.0], "5": [0.0, 9.0]}, {"1": []}, {"9": [1.0, 2.0]}, {}, None),
        "known": ({}, {"0": []}, {"x": ["r", None]}, {"0": ["r", [1e308, float("nan")]]}, {"0": ["r", [91.0, 500.0]]}),
        "verdicts": ([], [{}], None, "x", 5),
        "folders": ([], ["a"], [1, 2], None, "ab"),
        "leaks": ([{}], 5, [{"query_path": 1, "reference_path": 2, "kind": 3}]),
        "metres": ({}, {"median": "x"}, 5),
        "precision_recall": ({}, {"points": []}, 5),
        "unanswerable_rule": ("x", None, [], 5),
        "format": (2, None, "1", True, 10**30),
        "seconds": (float("nan"), "x", None, 1e308),
        "drawn": (5, [], {"by": {}, "units": "x"}),
    }.items():
        for value in values:
            yield given(f"{name} is {str(value)[:40]}", told(result() | {name: value}), "harmless")
    for field, values in {
        "matches": ([10**30], [-1], [0] * 100_000, "0", None, [True]),
        "scores": ([float("nan")], [1e308], [], "x"),
        "where": ([float("nan"), 1.0], [1e308, 1e308], [91.0, 181.0], [], [1.0], "ab"),
        "metres": (float("inf"), -1.0, "x", 1e308),
        "positives": (10**30, -1),
        "first_right": (10**30, -1, 0),
        "right": (10**30, -1, 5),
        "group": (5, "\x1b[2J", "g" * 1_000_000),
    }.items():
        for value in values:
            made = result()
            made["verdicts"][0][field] = value
            yield given(f"a query's {field} is {str(value)[:20]}", told(made), "harmless")
    for what, content in {
        "lists 100,000 deep": b"[" * 100_000,
        "objects 100,000 deep": b'{"verdicts":' * 100_000,
        "no text": b"\xff\xfe",
        "nothing": b"",
        "a list": b"[]",
        "a number of a million digits": b'{"verdicts":' + b"9" * 1_000_000 + b"}",
        "a million empty lists": b"[" + b"[]," * 1_000_000 + b"[]]",
    }.items():

        def make(scene: Scene, content: bytes = content) -> None:
            (scene.given / "r.json").write_bytes(content)

        yield given(what, make, "refused")
    for what, how in {
        "a pipe": lambda scene: os.mkfifo(scene.given / "r.json"),
        "a link to an endless device": lambda scene: (scene.given / "r.json").symlink_to("/dev/zero"),
        "a folder": lambda scene: (scene.given / "r.json").mkdir(),
    }.items():
        yield given(what, how, "refused")

    def endless(scene: Scene) -> None:
        with (scene.given / "r.json").open("wb") as file:
            file.truncate(5 << 30)

    yield given("5 GB", endless, "refused")


def given(what: str, make: Callable[[Scene], object], right: Answer = "refused", *,
          also: Callable[[Scene], list[str]] | None = None) -> Attack:  # fmt: skip
    """A result that is shown and compared."""
    names = "r.json" if right == "refused" else ""
    return Attack(f"a result: {what}", make, right, names, SHOWN + COMPARED, also=also)


ALL = [attack for some in (leading_out, lying) for attack in some()]
