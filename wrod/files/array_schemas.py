"""What the .npz files that wrod reads hold: a table each, from which docs/formats.md is printed.

Letters in a shape are lengths; the same letter is the same length within a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wrod.errors import DataError, WrodError


@dataclass(frozen=True)
class Field:
    """An array of a file.

    Attributes:
        shape: lengths, as numbers or letters.
        unit: of its values, "" for none.
        needed: whether a file without it is refused.
        kind: "numbers", "whole numbers", "truths" or "text".
        about: what it is, where the name does not say it.
    """

    shape: tuple[int | str, ...] = ()
    unit: str = ""
    needed: bool = True
    kind: str = "numbers"
    about: str = ""


@dataclass(frozen=True)
class ArrayFile:
    """A kind of file: what it is, and its arrays by name."""

    about: str
    fields: Mapping[str, Field]


_KINDS = {"numbers": "fiu", "whole numbers": "iu", "truths": "b", "text": "US"}

ARRAYS = {
    "Trajectory": ArrayFile(
        "A trajectory that `wrod plan` wrote (`--trajectory`).",
        {
            "format": Field(kind="text", about="`wrod-trajectory-1`"),
            "metadata": Field(kind="text", needed=False, about="JSON of TrajectoryMetadata"),
            "arc_length": Field(("T",), "m", about="laid length, rising"),
            "contact": Field(("T", 3), "m"),
            "position": Field(("T", 3), "m"),
            "rotation": Field(("T", 3, 3), about="rotation matrices"),
            "force": Field(("T", 3), "N"),
            "shape": Field(("T", "N", 3), "m", needed=False),
            "twist": Field(("T",), "rad", needed=False),
            "roll": Field((), "rad", needed=False),
        },
    ),
    "Deployment": ArrayFile(
        "A deployment that `wrod deploy` wrote.",
        {
            "format": Field(kind="text", about="`wrod-deployment-1`"),
            "arc_length": Field(("N",), "m"),
            "centerline": Field(("N", 3), "m"),
            "error_mean": Field((), "m"),
            "error_std": Field((), "m"),
            "released_centerline": Field(("N", 3), "m"),
            "released_error_mean": Field((), "m"),
            "released_error_std": Field((), "m"),
            "contact_force": Field(("N", 3), "N"),
            "slip": Field(("N",), "m"),
            "diverged": Field(kind="truths"),
            "duration": Field((), "s"),
            "steps": Field(kind="whole numbers"),
            "frames": Field(("F", "N", 3), "m", needed=False),
            "hand": Field(("F", 4, 4), needed=False),
            "let_go": Field((), "s", needed=False),
            "released_speed": Field((), "m/s", needed=False),
            "penetration": Field((), "m", needed=False),
        },
    ),
    "JointPath": ArrayFile(
        "A joint path that `wrod plan` wrote.",
        {
            "format": Field(kind="text", about="`wrod-joint-path-1`"),
            "metadata": Field(kind="text", about="a JSON object"),
            "names": Field(("J",), kind="text"),
            "time": Field(("K",), "s"),
            "positions": Field(("K", "J"), "rad"),
            "velocities": Field(("K", "J"), "rad/s"),
            "arc_length": Field(("K",), "m"),
            "node_time": Field(("T",), "s"),
            "node_positions": Field(("T", "J"), "rad"),
            "placement": Field((4,), about="x, y, z [m] and yaw [rad]"),
            "grip": Field((2,), "rad", about="angle and roll"),
        },
    ),
    "ClampedMeasurements": ArrayFile(
        "A rod held between two clamps (`wrod identify`).",
        {
            "centerline": Field(("T", "M", 3), "m", about="markers; NaN where not seen"),
            "arc_length": Field(("M",), "m"),
            "clamp_position": Field(("T", 3), "m"),
            "clamp_rotation": Field(("T", 3, 3)),
            "grip_position": Field(("T", 3), "m"),
            "grip_rotation": Field(("T", 3, 3)),
            "grip_force": Field(("T", 3), "N", needed=False),
            "grip_torque": Field(("T", 3), "N m", needed=False),
            "train_idx": Field(("A",), kind="whole numbers"),
            "test_idx": Field(("B",), kind="whole numbers"),
            "length": Field((), "m"),
            "radius": Field((), "m"),
            "density": Field((), "kg/m^3"),
            "L_gb": Field((), "m"),
            "poisson": Field(),
            "gravity": Field((), "m/s^2"),
            "noise_std": Field((), "m"),
        },
    ),
    "MotionMeasurements": ArrayFile(
        "Recordings of a rod that two grips move (`wrod identify`).",
        {
            "positions": Field(("R", "T", "M", 3), "m", about="markers; NaN where not seen"),
            "rate_hz": Field((), "Hz"),
            "held": Field((4,), kind="whole numbers", about="markers inside the grips"),
            "gravity": Field((), "m/s^2"),
            "file_ids": Field(("R",), needed=False, kind="whole numbers"),
        },
    ),
    "Points": ArrayFile(
        "Points of a pattern, or a laid rod; an .npy file holds the points alone.",
        {
            "points": Field(("N", "2 or 3"), "m, or the unit that `units` names"),
            "units": Field(kind="text", needed=False),
        },
    ),
}


def check_arrays(
    data: Mapping[str, np.ndarray],
    kind: str,
    where: str,
    error: type[WrodError] = DataError,
) -> None:
    """Refuse arrays that are not as `ARRAYS[kind]` says; others beside them are let be.

    Args:
        data: arrays by name.
        kind: a name of `ARRAYS`.
        where: begins the sentence: the file.
        error: type of the refusal.

    Raises:
        WrodError: of type `error`; names the array.
    """
    lengths: dict[str, tuple[int, str]] = {}
    for name, field in ARRAYS[kind].fields.items():
        if name not in data:
            if field.needed:
                raise error(f"{where}: lacks the array {name}; that is no {kind}")
            continue
        array = np.asarray(data[name])
        if array.dtype.kind not in _KINDS[field.kind]:
            raise error(f"{where}: {name} holds {array.dtype} values; it must hold {field.kind}")
        said = f"({', '.join(map(str, field.shape))})"
        if array.ndim != len(field.shape):
            raise error(f"{where}: {name} has shape {array.shape}; it must have {said}")
        for have, want in zip(array.shape, field.shape, strict=True):
            if isinstance(want, str):
                want, first = lengths.setdefault(want, (have, name))
                beside = "" if first == name else f", and {first} is {want} long there"
            else:
                beside = ""
            if have != want:
                raise error(f"{where}: {name} has shape {array.shape}; it must have {said}{beside}")
