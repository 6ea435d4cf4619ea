"""Measurements of cables held in a hand: few markers, projected shapes, one plane.

SI units. Where a cable is held by one end, coordinates are the hand's: the cable leaves the clamp
along (0, -1), and gravity is g (sin Gamma, -cos Gamma) at the hand's angle Gamma.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from wrod.files import read_fields

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
    data = read_fields(path, "HangingLoops")
    return HangingLoops(Path(path).stem.split("-")[0], **data)


def load_held(path: str | os.PathLike[str]) -> HeldCable:
    """Read SET-static.npz; raises as `load_hanging`."""
    return _held(path, read_fields(path, "HeldCable"), "-static")


def load_swing(path: str | os.PathLike[str]) -> HeldSwing:
    """Read SET-swing.npz; raises as `load_hanging`."""
    data = read_fields(path, "HeldSwing")
    time, bend = data.pop("time"), data.pop("curvature_fit")
    data["mid"], data["end"] = data.pop("mid_fitted"), data.pop("end_fitted")
    return HeldSwing(_held(path, data, "-swing"), time, bend)


def load_poses(path: str | os.PathLike[str]) -> HeldPoses:
    """Read poses-3d.npz; raises as `load_hanging`."""
    data = read_fields(path, "HeldPoses")
    turns = (np.radians(data.pop(f"{name}_deg")) for name in ("gripper_axis_angle", "end_turn"))
    data["gripper_turn"], data["end_turn"] = turns
    return HeldPoses(**data)


def _held(path: str | os.PathLike[str], data: dict, suffix: str) -> HeldCable:
    angle = data.pop("base_angle")
    return HeldCable(name=Path(path).stem.removesuffix(suffix), angle=angle, **data)
