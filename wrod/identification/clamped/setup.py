"""The model of one rod between two clamps as plain arrays, which effects change."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.setup import RodSetup

# What has a row for each trial anyway, and arrays of the rod that may have one.
_OF_TRIALS = ("force", "clamp_position", "clamp_rotation", "grip_position", "grip_rotation")
_OF_THE_ROD = {
    "bending": 2, "twisting": 1, "stretching": 1, "natural_curvature": 2, "natural_twist": 1,
    "line_mass": 1, "gravity": 1,
}  # fmt: skip


@dataclass
class ClampedSetup(RodSetup):
    """A rod of n edges between the clamps in T trials, and how it is held and seen.

    Arrays of a rod that is another one in each trial have one row of them more, (T, ...).

    Attributes:
        trials: (T,) their numbers in the order in which they were taken.
        when: (T,) the same as a share of the whole series, 0 at its first trial, 1 at its last.
        length: free length between the clamps [m].
        law: (J, 2), of a moment M = B k (1 - sum_j p_j c_j k^2 / (1 + c_j k^2)) besides softening:
            c [m^2] and p of every term; no rows: none.
        coupling: (2,) G of an energy per length G . e (tau - tau_0) of the excess curvatures along
            (m1, m2) and the twist [N m^2].
        wind: (3,) w of the force |w_perp| w_perp per length, w_perp across the rod [(N/m)^1/2].
        force: (T, n + 1, 3), broadcast: dead force on each node [N].
        clamp_position, grip_position: (T, 3) [m].
        clamp_rotation, grip_rotation: (T, 3, 3), columns m1, m2, tangent.
        marker_arc_length: (M,) unstretched arc length of each marker from the clamp [m].
        measured: (T, n + 1, 3) where markers and clamps say that the nodes are, for loads that
            depend on the place in the laboratory (real) [m].
    """

    trials: np.ndarray
    when: np.ndarray
    length: complex
    law: np.ndarray
    coupling: np.ndarray
    wind: np.ndarray
    force: np.ndarray
    clamp_position: np.ndarray
    clamp_rotation: np.ndarray
    grip_position: np.ndarray
    grip_rotation: np.ndarray
    marker_arc_length: np.ndarray
    measured: np.ndarray

    @classmethod
    def base(
        cls, measurements: ClampedMeasurements, trials: np.ndarray, edge_count: int
    ) -> ClampedSetup:
        """The straight, uniform, isotropic, linear rod clamped as reported."""
        m, rod = measurements, measurements.material
        return cls.plain(
            np.linspace(0.0, 1.0, edge_count + 1),
            rod.bending_stiffness,
            rod.twisting_stiffness,
            rod.stretching_stiffness,
            rod.weight / rod.gravity,
            rod.gravity,
            trials=trials,
            when=trials / max(m.trial_count - 1, 1),
            length=rod.length,
            law=np.zeros((0, 2)),
            coupling=np.zeros(2),
            wind=np.zeros(3),
            force=np.zeros((1, 1, 3)),
            clamp_position=m.clamp_position[trials],
            clamp_rotation=m.clamp_rotation[trials],
            grip_position=m.grip_position[trials],
            grip_rotation=m.grip_rotation[trials],
            marker_arc_length=m.arc_length.copy(),
            measured=m.node_positions(edge_count)[trials],
        )

    @property
    def arc_length(self) -> np.ndarray:
        """(n + 1,) unstretched arc length of each node [m]."""
        return self.fraction * self.length

    def rods(self) -> list[ClampedSetup]:
        """The set-up of each trial's rod, or only one where all have the same."""
        apart = [n for n, axes in _OF_THE_ROD.items() if np.ndim(getattr(self, n)) > axes]
        if not apart:
            return [self]
        rods = [copy.copy(self) for _ in self.trials]
        for name in apart:
            for rod, own in zip(rods, getattr(self, name), strict=True):
                setattr(rod, name, own)
        return rods

    def put_together(self, each: Sequence[ClampedSetup]) -> None:
        """Be in every trial as the one of `each` (T,) is that stands for it, a rod of `rods`."""
        for name in (*_OF_THE_ROD, *_OF_TRIALS):
            parts, known = [getattr(one, name) for one in each], getattr(self, name)
            if all(part is known for part in parts):
                continue
            if name in _OF_TRIALS:
                parts = [part[min(t, len(part) - 1)] for t, part in enumerate(parts)]
            setattr(self, name, np.stack(parts))

    def push(self, line_force: np.ndarray) -> None:
        """Loads the rod with a dead force per length, (n + 1, 3) or one of each trial [N/m]."""
        self.force = self.force + self.cells()[:, None] * line_force

    def cells(self) -> np.ndarray:
        """(n + 1,) length of rod that each node stands for [m]."""
        cell = np.full(len(self.fraction), self.length / (len(self.fraction) - 1))
        cell[[0, -1]] *= 0.5
        return cell

    def weights_at(self, arc_length) -> np.ndarray:
        """(n + 1,) smooth shares of the nodes around a point: their sum is 1, their mean the point.

        Quadratic B-splines, so that a mass may slide along the rod without a kink.
        """
        count = len(self.fraction) - 1
        u = arc_length / self.length * count
        i = int(np.clip(np.rint(np.real(u)), 1, count - 1))
        v = u - i
        shares = np.zeros(count + 1, dtype=np.result_type(u, float))
        shares[i - 1 : i + 2] = 0.5 * (0.5 - v) ** 2, 0.75 - v**2, 0.5 * (0.5 + v) ** 2
        return shares


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a rotation vector; analytic, for complex steps (Rodrigues)."""
    x, y, z = vector
    cross = np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])
    square = np.dot(vector, vector)
    if abs(square) < 1e-8:
        a, b = 1 - square / 6 + square**2 / 120, 0.5 - square / 24 + square**2 / 720
    else:
        angle = np.sqrt(square)
        a, b = np.sin(angle) / angle, (1 - np.cos(angle)) / square
    return np.eye(3) + a * cross + b * (cross @ cross)
