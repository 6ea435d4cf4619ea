"""Measurements of rods held between two clamps, checked on the way in."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.files import check_arrays, read_fields
from wrod.identification.clamped.checks import check_rod, checked_geometry
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.rods.material import RodMaterial


@arguments.checked(DataError)
def load_measurements(path: str | os.PathLike[str]) -> ClampedMeasurements:
    """Read a set of clamped equilibria (.npz, fields as in `ClampedMeasurements`) and check it.

    The fields are `centerline`, `arc_length`, `clamp_position`, `clamp_rotation`,
    `grip_position`, `grip_rotation`, `train_idx`, `test_idx`, the scalars `length`, `radius`,
    `density`, `L_gb`, `poisson`, `gravity`, `noise_std`, and, where it was measured, the wrench
    `grip_force`, `grip_torque`.

    Raises:
        DataError: the file is unreadable or lacks a field, or a value cannot be right; the
            sentence names the field, the trial and the marker.
    """
    path = Path(path)
    return _checked(read_fields(path, "ClampedMeasurements"), path.stem, str(path))


def measurements_from_arrays(
    data: dict[str, np.ndarray], *, name: str = "measurements"
) -> ClampedMeasurements:
    """The same from a dictionary of arrays; `name` starts the sentences of errors."""
    return _checked(check_arrays(data, "ClampedMeasurements", name), name, name)


def _checked(data: dict, name: str, where: str) -> ClampedMeasurements:
    try:
        material = RodMaterial(
            data.pop("radius"),
            data.pop("L_gb"),
            data.pop("length"),
            data.pop("poisson"),
            data.pop("density"),
            data.pop("gravity"),
        )
    except ValueError as error:
        raise DataError(f"{where}: {error}") from None
    noise = data.pop("noise_std")
    check_rod(material, noise, where)
    _check_seen(data["centerline"], where)
    trials = len(data["centerline"])
    train, test = (_indices(data.pop(key), key, trials, where) for key in ("train_idx", "test_idx"))
    if both := sorted(set(train) & set(test)):
        raise DataError(f"{where}: trial {both[0]} is in train_idx and in test_idx")
    measured: dict[str, Any] = {"grip_force": None, "grip_torque": None, **data}
    measurements = ClampedMeasurements(
        name=name, material=material, train=train, test=test, noise=noise, **measured
    )
    return checked_geometry(measurements, where)


def _check_seen(centerline: np.ndarray, where: str) -> None:
    """A marker that was not seen costs its own readings, half of a rod its trial.

    Raises:
        DataError: a trial has fewer than 3 markers, or fewer than half of them.
    """
    seen = np.isfinite(centerline).all(axis=2).sum(axis=1)
    least = max(3, (centerline.shape[1] + 1) // 2)
    if (seen < least).any():
        trial = int(np.argmin(seen))
        raise DataError(
            f"{where}: centerline of trial {trial} has {seen[trial]} of {centerline.shape[1]} "
            f"markers, the others are not numbers; leave that trial out"
        )


def _indices(value: np.ndarray, key: str, trials: int, where: str) -> np.ndarray:
    if value.max() >= trials or len(set(value.tolist())) < len(value):
        raise DataError(
            f"{where}: {key} must list different trials between 0 and {trials - 1}, at least one"
        )
    return value
