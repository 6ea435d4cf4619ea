"""`wrod bench perception`: accuracy and time of the centrelines of labelled photographs."""

import time
from pathlib import Path
from typing import Any

import click

from wrod import cost
from wrod.errors import DataError, WrodError
from wrod.machine import machine_line
from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(name="perception")
@own_options
@json_option
def command(
    images: Path = option(
        "Folder with SET/images/*.jpg, SET/gt/*.png (labels) and SET/crossings.json.",
        type=FOLDER,
        default=Path("../shared/images/dlo"),
    ),
    source: str = option(None, type=click.Choice(["mask", "photo"]), default="mask"),
    repeats: int = option("Timed runs per picture.", default=5),
) -> None:
    """Trace every picture from its union mask or from the photograph, and score it.

    Dice is that of the paths drawn with their radius, the best match of paths and labels; count
    and order are the share of pictures with the right number of paths and of crossings.
    """
    import cv2
    import numpy as np

    from wrod.files import read_json
    from wrod.perception.image import read_image
    from wrod.perception.score import finite_mean, score_paths
    from wrod.perception.trace import trace_centerlines

    sets = sorted(p.parent for p in images.glob("*/gt") if p.is_dir())
    if not sets:
        raise DataError(f"{images}: no SET/gt folder with labels; give --images FOLDER")
    cv2.setNumThreads(1)
    runs = repeats * sum(len(list((folder / "gt").glob("*.png"))) for folder in sets)
    work = cost.Cost(runs * cost.TRACED_PIXEL * 640 * 480)
    cost.settle(work, f"{runs} runs", "ask for fewer --repeats")
    rows: list[dict[str, Any]] = []
    for folder in sets:
        counts = folder / "crossings.json"
        crossings = read_json(counts, dict[str, int], "counts") if counts.exists() else {}
        labels = sorted((folder / "gt").glob("*.png"))
        for file in cost.progress_bar(labels, unit="picture", desc=folder.name):
            label = read_image(file)
            if label.ndim != 2:
                raise DataError(f"{file}: is a picture in colour; a label has a grey for each rod")
            photo = label > 0
            if source == "photo":
                photo = read_image(folder / "images" / f"{file.stem}.jpg")
            lines, times = [], []
            for _ in range(repeats):
                clock = time.process_time()
                try:
                    lines = trace_centerlines(photo)
                except WrodError:
                    lines = []
                times.append(time.process_time() - clock)
            score = score_paths(lines, label, crossings.get(file.stem))
            rows.append(
                {"set": folder.name, "image": file.stem, "ms": 1e3 * float(np.median(times))}
                | score
            )
    names = ("dice", "count", "order", "offset_px")
    table = [
        {"set": name, "pictures": len(part)}
        | {key: finite_mean([row[key] for row in part]) for key in names}
        | {"ms": float(np.median([row["ms"] for row in part]))}
        for name in sorted({row["set"] for row in rows})
        if (part := [row for row in rows if row["set"] == name])
    ]
    tell(
        {"machine": machine_line(), "sets": table, "rows": rows},
        f"from the {source}, one thread, median CPU time",
        f"{'set':>6} {'pictures':>9} {'Dice %':>7} {'count %':>8} {'order %':>8} "
        f"{'offset px':>10} {'ms':>6}",
        *(
            f"{row['set']:>6} {row['pictures']:9d} {100 * row['dice']:7.2f} "
            f"{100 * row['count']:8.1f} {100 * row['order']:8.1f} {row['offset_px']:10.3f} "
            f"{row['ms']:6.1f}"
            for row in table
        ),
    )
