"""Two lines to copy for each command, shown at the end of its help."""

from __future__ import annotations

EXAMPLES = {
    "index": ("salad index holiday --to city.index", "salad index scans --to city.index --table places.csv"),
    "locate": (
        "salad locate query.jpg --index city.index",
        "salad locate queries --index city.index --format geojson > found.geojson",
    ),
    "info": ("salad info city.index", "salad info city.index --format json"),
    "verify": ("salad verify city.index", "salad verify ~/maps/north.index"),
    "remove": (
        "salad remove holiday/blurred.jpg --index city.index",
        "salad remove holiday/indoors --index city.index",
    ),
    "compact": ("salad compact city.index", "salad compact city.index --drop-damaged"),
    "compress": ("salad compress city.index", "salad compress city.index --off"),
    "export": (
        "salad export city.index --to city.export",
        "salad export city.index --to for-gis --format geojson",
    ),
    "merge": ("salad merge city.index north.index south.index", "salad merge everything.index city.index"),
    "evaluate": (
        "salad evaluate --references database --queries queries --radius 25",
        "salad evaluate --references day_left --queries day_right --frames 2",
    ),
    "datasets": ("salad datasets list", "salad datasets check ~/sets/sped"),
    "weights": ("salad weights list", "salad weights convert dino_salad.ckpt --to my-model"),
    "quantize": (
        "salad quantize salad-lite --photos holiday walk --to lite-int8",
        "salad quantize salad-vits --photos holiday --to vits-bf16 --precision bf16",
    ),
    "export-model": (
        "salad export-model salad-vits --to salad-vits.onnx",
        "salad export-model megaloc --to megaloc.onnx --photos holiday",
    ),
    "places": (
        "salad places holiday --to places.csv",
        "salad places scans --table positions.csv --to places.csv --cell 15",
    ),
    "train": (
        "salad train --data places.csv --to runs/mine",
        "salad train --preset paper --data gsv-cities --dry-run",
    ),
    "compare": (
        "salad compare theirs.json mine.json",
        "salad compare --grid parts --data PHOTOS --to runs/parts",
    ),
    "demo": ("salad demo", "salad demo --to town"),
}
