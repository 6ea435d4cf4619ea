"""Measurements of rods held between two clamps, checked on the way in."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.files import read_arrays
from wrod.identification.clamped.checks import check_geometry, check_rod
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.rods.material import RodMaterial

_SCALARS = ("length", "radius", "density", "L_gb", "poisson", "gravity", "noise_std")


@arguments.checked(DataError, path=arguments.path)
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
    data = read_arrays(path, "an .npz file of measurements")
    return measurements_from_arrays(data, name=path.stem, where=str(path))


def measurements_from_arrays(
    data: dict[str, np.ndarray], *, name: str = "measurements", where: str | None = None
) -> ClampedMeasurements:
    """The same from a dictionary of arrays; `where` starts the sentences of errors."""
    where = where or name
    arrays = {key: _numbers(data, key, where) for key in _SCALARS}
    for key in _SCALARS:
        if arrays[key].ndim != 0:
            raise DataError(f"{where}: {key} has shape {arrays[key].shape}; give one number")
    scalars = {key: float(arrays[key]) for key in _SCALARS}
    if not scalars["noise_std"] > 0:
        raise DataError(f"{where}: noise_std is {scalars['noise_std']:g}; it must be positive")
    try:
        material = RodMaterial(
            scalars["radius"],
            scalars["L_gb"],
            scalars["length"],
            scalars["poisson"],
            scalars["density"],
            scalars["gravity"],
        )
    except ValueError as error:
        raise DataError(f"{where}: {error}") from None
    check_rod(material, scalars["noise_std"], where)
    centerline = _numbers(data, "centerline", where)
    if centerline.ndim != 3 or centerline.shape[2] != 3:
        raise DataError(f"{where}: centerline has shape {centerline.shape}; give (T, M, 3)")
    trials, markers = centerline.shape[:2]
    if trials < 2:
        raise DataError(
            f"{where}: holds {trials} trial; one shape cannot tell an unmodelled effect from "
            "another, so give 2 or more"
        )
    shapes = {
        "arc_length": (markers,),
        "clamp_position": (trials, 3),
        "clamp_rotation": (trials, 3, 3),
        "grip_position": (trials, 3),
        "grip_rotation": (trials, 3, 3),
    }
    wrench = ("grip_force" in data, "grip_torque" in data)
    if any(wrench) and not all(wrench):
        raise DataError(f"{where}: has only one of grip_force and grip_torque; give both or none")
    if all(wrench):
        shapes |= {"grip_force": (trials, 3), "grip_torque": (trials, 3)}
    values = {"centerline": centerline}
    for key, shape in shapes.items():
        values[key] = _numbers(data, key, where)
        if values[key].shape != shape:
            raise DataError(f"{where}: {key} has shape {values[key].shape}; expected {shape}")
    _check_seen(centerline, where)
    for key, value in values.items():
        if key != "centerline" and not np.isfinite(value).all():
            place = np.argwhere(~np.isfinite(value))[0]
            kind = "marker" if key == "arc_length" else "component"
            at = f"trial {place[0]}" + (f", {kind} {place[1]}" if len(place) > 1 else "")
            at = f"{kind} {place[0]}" if key == "arc_length" else at
            raise DataError(f"{where}: {key} of {at} is not a number; leave that trial out")
    train, test = (_indices(data, key, trials, where) for key in ("train_idx", "test_idx"))
    if len(train) < 2:
        raise DataError(
            f"{where}: train_idx holds 1 trial; what is fitted to one shape cannot be checked on "
            "another, so give 2 or more"
        )
    if both := sorted(set(train) & set(test)):
        raise DataError(f"{where}: trial {both[0]} is in train_idx and in test_idx")
    measured: dict[str, Any] = {"grip_force": None, "grip_torque": None, **values}
    measurements = ClampedMeasurements(
        name=name,
        material=material,
        train=train,
        test=test,
        noise=scalars["noise_std"],
        **measured,
    )
    check_geometry(measurements, where)
    return measurements


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


def _numbers(data, key: str, where: str) -> np.ndarray:
    if key not in data:
        raise DataError(f"{where}: has no field {key}")
    try:
        return np.asarray(data[key], dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(f"{where}: {key} does not hold numbers") from None


def _indices(data, key: str, trials: int, where: str) -> np.ndarray:
    value = _numbers(data, key, where)
    whole = value.ndim == 1 and value.size > 0 and np.all(value == np.floor(value))
    if not whole or value.min() < 0 or value.max() >= trials or len(set(value)) < len(value):
        raise DataError(
            f"{where}: {key} must list different trials between 0 and {trials - 1}, at least one"
        )
    return value.astype(np.int64)
