"""Measurements of rods held between two clamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from wrod.errors import DataError
from wrod.records import brief
from wrod.rods.material import RodMaterial

# Edges of the mesh on which curvatures are read off markers.
_COARSE = 8


@brief
@dataclass(frozen=True)
class ClampedMeasurements:
    """T static equilibria of one rod between clamp A (arc length 0) and gripper B; SI units.

    Attributes:
        name: what the data are called.
        material: the rod as its user measured it; `material.length` is the free length [m].
        centerline: (T, M, 3) measured marker positions [m]; NaN where one was not seen.
        arc_length: (M,) unstretched arc length of each marker from clamp A [m].
        clamp_position, grip_position: (T, 3) reported ends of the free span [m].
        clamp_rotation, grip_rotation: (T, 3, 3) columns m1, m2, tangent along growing arc length.
        grip_force, grip_torque: (T, 3) wrench of the gripper on the rod, about `grip_position`
            [N], [N m]; None where none was measured.
        train, test: trial indices to fit on and to score on.
        noise: standard deviation of a marker coordinate [m].
        force_noise, torque_noise: (relative, absolute) standard deviation of one component
            [-], [N] or [N m].
    """

    name: str
    material: RodMaterial
    centerline: np.ndarray
    arc_length: np.ndarray
    clamp_position: np.ndarray
    clamp_rotation: np.ndarray
    grip_position: np.ndarray
    grip_rotation: np.ndarray
    grip_force: np.ndarray | None
    grip_torque: np.ndarray | None
    train: np.ndarray
    test: np.ndarray
    noise: float
    force_noise: tuple[float, float] = (0.02, 2e-3)
    torque_noise: tuple[float, float] = (0.02, 2e-4)

    @property
    def trial_count(self) -> int:
        return len(self.centerline)

    @property
    def noise_floor(self) -> float:
        """RMS distance of a perfect model from noisy markers [m]."""
        return np.sqrt(3.0) * self.noise

    @cached_property
    def largest_curvature(self) -> float:
        """What all but a tenth of the train trials' places are bent less than, on a mesh that
        noise hardly bends [1/m]."""
        edge = np.diff(self.node_positions(_COARSE)[self.train], axis=1)
        size = np.linalg.norm(edge, axis=2)
        t = edge / size[..., None]
        angle = np.arccos(np.clip((t[:, 1:] * t[:, :-1]).sum(axis=2), -1.0, 1.0))
        return float(np.quantile(2.0 * angle / (size[:, 1:] + size[:, :-1]), 0.9))

    @cached_property
    def _node_positions(self) -> dict[int, np.ndarray]:
        return {}

    def node_positions(self, edge_count: int) -> np.ndarray:
        """(T, n + 1, 3) where markers and clamps say that equidistant nodes are [m]."""
        if edge_count not in self._node_positions:
            length, s = self.material.length, self.arc_length
            at = np.linspace(0.0, length, edge_count + 1)
            out = np.empty((self.trial_count, len(at), 3))
            # Beside a clamp its own position says more than a marker.
            inner = (s > 1e-3 * length) & (s < (1.0 - 1e-3) * length)
            for t, line in enumerate(self.centerline):
                own = inner & np.isfinite(line).all(axis=1)
                ends = self.clamp_position[t], self.grip_position[t]
                known = np.concatenate([ends[:1], line[own], ends[1:]])
                place = np.concatenate([[0.0], s[own], [length]])
                out[t] = PchipInterpolator(place, known, axis=0)(at)
            self._node_positions[edge_count] = out
        return self._node_positions[edge_count]

    def scored_on(self, other: ClampedMeasurements) -> ClampedMeasurements:
        """These measurements to fit on, all of `other` to score on.

        Raises:
            DataError: `other` is of another rod or has other markers.
        """
        if other.material != self.material:
            raise DataError(f"{other.name} is of another rod than {self.name}; give one rod's data")
        if len(other.arc_length) != len(self.arc_length) or not np.allclose(
            other.arc_length, self.arc_length, atol=1e-9
        ):
            raise DataError(f"{other.name} has its markers elsewhere than {self.name}")
        wrench = self.grip_force is not None and other.grip_force is not None
        joined: dict[str, Any] = {
            key: np.concatenate([getattr(self, key), getattr(other, key)])
            for key in (
                "centerline",
                "clamp_position",
                "clamp_rotation",
                "grip_position",
                "grip_rotation",
                *(("grip_force", "grip_torque") if wrench else ()),
            )
        }
        if not wrench:
            joined |= {"grip_force": None, "grip_torque": None}
        test = np.arange(self.trial_count, self.trial_count + other.trial_count)
        return replace(self, **joined, test=test)
