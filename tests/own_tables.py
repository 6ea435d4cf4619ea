"""Tables as an engineer would have them, of rods that are known: what docs/how-to reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from test_ruler import L_GB, hanging

import wrod
from wrod.identification.held.equilibria import CableModel, markers
from wrod.identification.held.measurements import HeldCable
from wrod.identification.template import clamped_example, motion_example

# The cable in the hand.
HELD = CableModel(0.107, -1.5, 0.02)


def _write(path: Path, names: str, rows) -> None:
    path.parent.mkdir(exist_ok=True)
    cells = (",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in rows)
    path.write_text("\n".join([names, *cells]) + "\n")


def write_tables(folder: Path) -> dict[str, dict]:
    """Every table of docs/how-to/own-measurements.md, in millimetres; the arrays that they are of.

    Trials and markers are counted from 1. The fourth marker of the second trial and one of the
    first take were not seen.
    """
    clamped, motion = clamped_example(), motion_example()
    clamped["centerline"][1, 3] = np.nan
    motion["positions"][0, 7, 5] = np.nan
    seen = np.argwhere(np.isfinite(clamped["centerline"]).all(axis=2))
    places = [(*(i + 1), *1e3 * clamped["centerline"][tuple(i)]) for i in seen[::-1]]
    _write(folder / "markers.csv", "trial,marker,x,y,z", places)
    _write(folder / "places.csv", "# mm", 1e3 * clamped["arc_length"][:, None])
    poses = [
        (k + 1, end, *1e3 * at[k], *Rotation.from_matrix(turn[k]).as_quat())
        for end, (at, turn) in enumerate(
            (clamped[f"{name}_position"], clamped[f"{name}_rotation"]) for name in ("clamp", "grip")
        )
        for k in range(len(at))
    ]
    _write(folder / "clamps.csv", "trial,end,x,y,z,qx,qy,qz,qw", poses)
    for name, take in zip(motion["file_ids"], motion["positions"], strict=True):
        x, y, z = np.moveaxis(1e3 * take, -1, 0)
        up = np.stack([x, z, -y], axis=-1).reshape(len(take), -1)
        time = 12.5 + np.arange(len(take)) / motion["rate_hz"]
        _write(folder / "takes" / f"{name}.csv", "time,m0_x,...", np.column_stack([time, up]))
    angles = np.arange(-150.0, 151.0, 50.0)
    none = np.zeros((len(angles), 2))
    cable = HeldCable("true", np.radians(angles), none, none, 0.40, 0.020, 0.20, 0.03, 9.81)
    places, _ = markers([(cable, angle, HELD) for angle in cable.angle])
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1e-3, places.shape)
    rows = np.column_stack([angles, 1e3 * (places + noise).reshape(len(angles), -1)])
    _write(folder / "hand.csv", "angle,mid_x,mid_z,end_x,end_z", rows)
    hung = hanging(L_GB, 0.45, 0.10, 0.0)
    hung = hung + rng.normal(0.0, 5e-4, hung.shape)
    _write(folder / "loop.csv", "# mm", 1e3 * hung)
    letter = wrod.pattern("letter-U")
    laid = letter.sample(np.linspace(0.0, letter.length, 60))[0][:, :2]
    _write(folder / "table.csv", "x,y", 1e3 * laid)
    return {"clamped": clamped, "motion": motion, "laid": {"points": laid}}
