"""`wrod bench cables`: cross-validation of what is found in recordings of rods in motion.

Restartable: a fold that has ended is kept, and so is what one that was stopped has computed.
"""

import time
from pathlib import Path

import click
import numpy as np

from wrod import cost, side_by_side
from wrod.errors import DataError
from wrod.files import write_json
from wrod.files.ledger import Ledger
from wrod.files.row_schemas import FoldRow
from wrod.machine import machine_line
from wrod.options import FOLDER, SOURCE_FOLDER, option, own_options
from wrod.telling import json_option, tell


def fold_row(
    path: str, fold: int, number: int, contiguous: bool, device: str, out: str | None
) -> dict:
    """One fold of one rod: the whole selection without it, and the errors on it [mm].

    Args:
        out: folder where what is computed is kept until the fold has ended.
    """
    from wrod.identification.effect import Model, effects
    from wrod.identification.motion.data import folds, with_test
    from wrod.identification.motion.fit import MotionLaboratory
    from wrod.identification.motion.loading import load_motion
    from wrod.identification.motion.remembered import KnownSteps
    from wrod.identification.motion.selection import BASE, select_motion

    clock, cpu = time.perf_counter(), time.process_time()
    m = load_motion(path)
    m = with_test(m, folds(m.recording_count, number, contiguous=contiguous)[fold])
    kept = KnownSteps(Path(out) / f"{Path(path).stem}-{fold}.jsonl", m) if out else None
    rod = MotionLaboratory(m, device=device, remembered=kept)
    s = select_motion(rod, list(effects("motion").values()))
    seconds, cpu = time.perf_counter() - clock, time.process_time() - cpu
    windows = rod.windows(m.test)

    def each(model, values) -> dict[str, float]:
        seen, predicted, _ = rod.resolved(windows, model, values)
        error = seen.errors(predicted)
        mean = [1e3 * e[2:][seen[2:]].mean() for e, seen in zip(error, windows.seen, strict=True)]
        return dict(zip((m.names[r] for r in m.test), map(float, mean), strict=True))

    row = {
        "rod": Path(path).stem,
        "fold": fold,
        "undamped_mm": 1e3 * s.undamped,
        "base_mm": each(Model(s.model.effects[: len(BASE)]), s.base_values),
        "after_mm": each(s.model, s.values),
        "rounds": [
            {
                "accepted": r.accepted,
                "removed": r.removed,
                "reason": r.reason,
                "test_mm": 1e3 * r.test,
                "validation_mm": 1e3 * r.validation,
            }
            for r in s.rounds
        ],
        "effects": list(s.model.names[len(BASE) :]),
        "values": np.asarray(s.values).tolist(),
        "confounded": [p["effects"] for p in s.confounded],
        "seconds": seconds,
        "cpu_seconds": cpu,
    }
    if kept is not None:
        kept.forget()
    return row


def summary(rows: list[dict]) -> dict:
    """One rod over its folds: mean errors over all recordings, and each effect's share of the drop.

    The shares, the last fit's included, add up to the drop from the base model's error. An effect's
    share is zero in folds where it was not chosen.
    """
    weight = np.array([len(r["base_mm"]) for r in rows], dtype=float)
    weight /= weight.sum()

    def mean(values) -> float:
        return float(weight @ np.array(list(values)))

    base = mean(np.mean(list(r["base_mm"].values())) for r in rows)
    after = mean(np.mean(list(r["after_mm"].values())) for r in rows)
    share: dict[str, float] = {}
    for w, row in zip(weight, rows, strict=True):
        errors = [r["test_mm"] for r in row["rounds"]]
        for r, before, now in zip(row["rounds"][1:], errors, errors[1:], strict=False):
            name = r["accepted"] or r["removed"]
            if name:
                share[name] = share.get(name, 0.0) + w * (before - now)
    rest = base - after - sum(share.values())
    chosen = [e for row in rows for e in row["effects"]]
    return {
        "rod": rows[0]["rod"],
        "undamped_mm": mean(r["undamped_mm"] for r in rows),
        "base_mm": base,
        "after_mm": after,
        "median_after_mm": float(np.median([v for r in rows for v in r["after_mm"].values()])),
        "share_mm": dict(sorted(share.items(), key=lambda s: -s[1])),
        "last_fit_mm": rest,
        "chosen_in": {name: chosen.count(name) for name in share},
        "folds": len(rows),
        "cpu_seconds": float(np.mean([r["cpu_seconds"] for r in rows])),
    }


def lines(found: dict) -> list[str]:
    """What the terminal shows of one rod."""
    out = [
        f"{found['rod']}: base {found['base_mm']:.2f} mm (without internal damping "
        f"{found['undamped_mm']:.2f}), after {found['after_mm']:.2f} mm, median of recordings "
        f"{found['median_after_mm']:.2f}; {found['cpu_seconds']:.0f} s of processor a fold"
    ]
    for name, share in found["share_mm"].items():
        chosen = f"{found['chosen_in'][name]} of {found['folds']} folds"
        out.append(f"  {name:<26}{share:>7.2f} mm  {chosen}")
    return [*out, f"  {'fit to whole recordings':<26}{found['last_fit_mm']:>7.2f} mm"]


@click.command(name="cables")
@own_options
@json_option
def command(
    folder: Path = option(
        "Folder of recordings of rods in motion (.npz), one file a rod.",
        "--data",
        type=SOURCE_FOLDER,
        required=True,
    ),
    number: int = option(None, "--folds", default=7),
    contiguous: bool = option("Folds of neighbours, not every n-th recording."),
    workers: int = option(None, default=1),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
    out: Path | None = option(
        "Keep the folds that have ended (folds.jsonl) and the figures (cables.json) here.",
        type=FOLDER,
    ),
) -> None:
    """Cross-validate `wrod identify` on recordings of rods in motion.

    Every recording is predicted by a model that has not seen it: neither its fit nor the choice of
    its effects. With --out a run that was stopped goes on.
    """
    from wrod.identification.entry import identification_cost
    from wrod.identification.motion.loading import is_motion, load_motion
    from wrod.rods.device import resolve_device

    paths = [p for p in sorted(folder.glob("*.npz")) if is_motion(p)]
    if not paths:
        raise DataError(f"{folder}: holds no .npz file of recordings in motion")
    for path in paths:
        count = load_motion(path).recording_count
        if number > count:
            raise DataError(f"{path}: {count} recordings make no {number} folds; ask for fewer")
        if count - -(-count // number) < 4:
            raise DataError(
                f"{path}: {count} recordings in {number} folds leave less than 4 to fit and to "
                "choose effects by"
            )
    device = resolve_device(device)
    stems = [p.stem for p in paths]
    settings = {"folds": number, "contiguous": contiguous, "data": stems}
    kept = out / "folds.jsonl" if out else None
    ledger = Ledger(kept, settings, ("rod", "fold"), "cables", FoldRow)
    by_stem = {p.stem: str(p) for p in paths}
    # The rods in turn, so that a run which is stopped has some of each.
    jobs = [
        (by_stem[stem], k, number, contiguous, device, str(out) if out else None)
        for stem, k in ledger.lacking((stem, k) for k in range(number) for stem in stems)
    ]
    each = {str(p): identification_cost(p).seconds for p in paths}  # reads every file once
    work = cost.Cost(sum(each[job[0]] for job in jobs) / workers)
    cost.settle(work, f"{len(jobs)} folds", "ask for fewer")
    for _, row in cost.progress_bar(side_by_side.run(fold_row, jobs, workers), total=len(jobs)):
        ledger.add([row])
    rows = ledger.of((stem, k) for stem in stems for k in range(number))
    found = [summary([r for r in rows if r["rod"] == stem]) for stem in stems]
    content = {
        "machine": machine_line(device),
        "folds": number,
        "contiguous": contiguous,
        "summary": found,
        "rows": rows,
    }
    if out:
        write_json(out / "cables.json", content, allow_nan=False)
    kind = "contiguous folds" if contiguous else "folds of every n-th recording"
    written = [f"wrote {out / 'cables.json'}"] if out else []
    tell(content, f"{number} {kind}", *(line for part in found for line in lines(part)), *written)
