"""Measurements of cables held in a hand: few markers, projected shapes, one plane.

SI units. Where a cable is held by one end, coordinates are the hand's: the cable leaves the clamp
along (0, -1), and gravity is g (sin Gamma, -cos Gamma) at the hand's angle Gamma.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from wrod.errors import DataError
from wrod.files import read_arrays

# Points by which a fitted curve is integrated.
_CURVE_POINTS = 401


@dataclass(frozen=True)
class HangingLoops:
    """A cable hung as a loop between two exits, seen in its plane (x right, z up).

    Attributes:
        name: of the cable.
        shape: (mounting, point, 2) from the right exit to the left one [m].
        arc_length: (point,) [m].
        length: [m]; mass_per_length [kg/m]; gravity [m/s^2].
    """

    name: str
    shape: np.ndarray
    arc_length: np.ndarray
    length: float
    mass_per_length: float
    gravity: float


@dataclass(frozen=True)
class HeldCable:
    """A cable clamped in a hand, its middle and end seen at several angles of the hand.

    Attributes:
        name: of the set.
        angle: (K,) of the hand [rad].
        mid, end: (K, 2) in the hand's frame [m].
        length, diameter: [m]; cable_mass, tip_mass: [kg]; gravity: [m/s^2].
    """

    name: str
    angle: np.ndarray
    mid: np.ndarray
    end: np.ndarray
    length: float
    diameter: float
    cable_mass: float
    tip_mass: float
    gravity: float

    @property
    def markers(self) -> np.ndarray:
        """(K, 2, 2) middle and end [m]."""
        return np.stack([self.mid, self.end], axis=1)


@dataclass(frozen=True)
class HeldSwing:
    """A cable swinging from a hand at rest; markers of a fitted curve.

    Attributes:
        cable: its set, with the hand's angle per frame and the markers (T,) in place of (K,).
        time: (T,) [s].
        bend: (T, 2) of the curve that was fitted: its curvature is (b0 + b1 s / L) / L at the
            distance s from the clamp [-].
    """

    cable: HeldCable
    time: np.ndarray
    bend: np.ndarray

    def curve(self, frame: int, s: np.ndarray) -> np.ndarray:
        """(n, 2) places of a frame's fitted curve [m]; behind the clamp it is straight."""
        v = np.linspace(0.0, 1.0, _CURVE_POINTS)
        angle = self.bend[frame, 0] * v + 0.5 * self.bend[frame, 1] * v**2
        length = self.cable.length
        x, z = (
            -length * cumulative_trapezoid(f, v, initial=0.0)
            for f in (np.sin(angle), np.cos(angle))
        )
        s = np.asarray(s, dtype=float)
        at = np.clip(s / length, 0.0, 1.0)
        return np.column_stack([np.interp(at, v, x), np.interp(at, v, z) - np.minimum(s, 0.0)])


@dataclass(frozen=True)
class HeldPoses:
    """Cables between a fixed end and an arm: partly known shapes up to one rigid motion.

    Attributes:
        cables: names; shape: (cable, pose, point, 3) [m]; arc_length: (point,) [m].
        length: [m]; mass_per_length: (cable,) [kg/m].
        gripper_shift: (pose, 3) [m]; gripper_turn: (pose, 3) axis times angle [rad]; end_turn:
            (pose,) of the end about the cable [rad].
    """

    cables: tuple[str, ...]
    shape: np.ndarray
    arc_length: np.ndarray
    length: float
    mass_per_length: np.ndarray
    gripper_shift: np.ndarray
    gripper_turn: np.ndarray
    end_turn: np.ndarray


def load_hanging(path: str | os.PathLike[str]) -> HangingLoops:
    """Read CABLE-hanging.npz.

    Raises:
        DataError: unreadable, an array is missing or of a wrong shape, or a value is not usable.
    """
    data = _read(path, ("shape", "arc_length", "length", "mass_per_length", "gravity"))
    shape, along = data["shape"], data["arc_length"]
    shape = shape[None] if shape.ndim == 2 else shape
    if shape.ndim != 3 or shape.shape[1:] != (len(along), 2) or not np.isfinite(shape).all():
        raise DataError(f"{path}: shape is {shape.shape}; give finite (mounting, point, 2)")
    numbers = _positive(path, data, ("length", "mass_per_length", "gravity"))
    return HangingLoops(Path(path).stem.split("-")[0], shape, along, *numbers)


def load_held(path: str | os.PathLike[str]) -> HeldCable:
    """Read SET-static.npz; raises as `load_hanging`."""
    data = _read(path, ("base_angle", "mid", "end", *_CABLE))
    return _held(path, data, "mid", "end", "-static")


def load_swing(path: str | os.PathLike[str]) -> HeldSwing:
    """Read SET-swing.npz; raises as `load_hanging`."""
    names = ("time", "base_angle", "mid_fitted", "end_fitted", "curvature_fit", *_CABLE)
    data = _read(path, names)
    cable = _held(path, data, "mid_fitted", "end_fitted", "-swing")
    bend = data["curvature_fit"]
    if bend.shape != (*cable.angle.shape, 2) or not np.isfinite(bend).all():
        raise DataError(f"{path}: curvature_fit is {bend.shape}; give finite (frame, 2)")
    if data["time"].shape != cable.angle.shape or not (np.diff(data["time"]) > 0).all():
        raise DataError(f"{path}: time does not grow with the frames")
    return HeldSwing(cable, data["time"], bend)


def load_poses(path: str | os.PathLike[str]) -> HeldPoses:
    """Read poses-3d.npz; raises as `load_hanging`."""
    names = ("shape", "arc_length", "length", "mass_per_length", "gripper_shift",
             "gripper_axis_angle_deg", "end_turn_deg", "cables")  # fmt: skip
    data = _read(path, names, text=("cables",))
    shape = data["shape"]
    if shape.ndim != 4 or shape.shape[-1] != 3 or not np.isfinite(shape).all():
        raise DataError(f"{path}: shape is {shape.shape}; give finite (cable, pose, point, 3)")
    (length,) = _positive(path, data, ("length",))
    return HeldPoses(
        tuple(str(name) for name in data["cables"]),
        shape,
        data["arc_length"],
        length,
        data["mass_per_length"],
        data["gripper_shift"],
        np.radians(data["gripper_axis_angle_deg"]),
        np.radians(data["end_turn_deg"]),
    )


_CABLE = ("length", "cable_mass", "tip_mass", "diameter", "gravity")


def _held(path, data, mid, end, suffix) -> HeldCable:
    angle = data["base_angle"]
    wanted = (*angle.shape, 2)
    for name in (mid, end):
        if data[name].shape != wanted or not np.isfinite(data[name]).all():
            raise DataError(f"{path}: {name} is {data[name].shape}; give finite {wanted}")
    length, mass, diameter, gravity = _positive(
        path, data, ("length", "cable_mass", "diameter", "gravity")
    )
    tip = float(data["tip_mass"])
    if not (np.isfinite(tip) and tip >= 0.0):
        raise DataError(f"{path}: tip_mass is {tip!r}; give kilograms, 0 or more")
    name = Path(path).stem.removesuffix(suffix)
    return HeldCable(name, angle, data[mid], data[end], length, diameter, mass, tip, gravity)


def _read(path, names, text=()) -> dict[str, np.ndarray]:
    found = read_arrays(path, "a measurement of a cable held at its base", only=names)
    missing = [name for name in names if name not in found]
    if missing:
        raise DataError(f"{path}: has no {', '.join(missing)}")
    words = [name for name in names if name not in text and found[name].dtype.kind not in "fiu"]
    if words:
        raise DataError(f"{path}: {', '.join(words)} must hold numbers")
    return found


def _positive(path, data, names) -> list[float]:
    values = []
    for name in names:
        value = float(data[name]) if data[name].ndim == 0 else np.nan
        if not (np.isfinite(value) and value > 0.0):
            raise DataError(f"{path}: {name} is {data[name]!r}; give a positive number")
        values.append(value)
    return values
