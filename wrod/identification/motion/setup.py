"""The model of a rod in motion as plain arrays, which effects change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wrod.identification.setup import RodSetup
from wrod.rods.discretisation import cells, in_principal, of_free_part

# What the base model starts from where nothing is known. Motion only tells ratios to the weight.
START_L_GB = 0.2
# Radius over gravito-bending length of the USB cable of the paper's Table 2.
SLENDER = 0.0018 / 0.0801
_POISSON = 0.5
# Share of its cell by which a node bends that is within a rigid stretch.
_RIGID = 1e-2


@dataclass
class MotionSetup(RodSetup):
    """A rod of n edges between two grips, and what it moves in; M markers.

    All is per mean line mass: a stiffness is in m^4/s^2, a mass in m, the line mass relative to the
    mean. Held nodes are outside the free length.

    Attributes:
        marker_node: (M,) node of each marker (int).
        mean_length: (n,) of the edges under their mean tension [m].
        mean_tension: (2, n) by the load [m^2/s^2], and by each m^4/s^2 of bending stiffness.
        force: (n + 1, 3) other forces per mass, fixed in the laboratory [m/s^2].
        linear_drag: (n + 1,) force per mass and velocity [1/s].
        quadratic_drag: (n + 1,) force per mass and velocity squared [1/m].
        viscous_time: (n + 1, 3) Kelvin-Voigt time of bending (two directions) and twisting [s], the
            first of stretching, too; the moment that softens is that of the strain and its rate
            times it.
        relaxation_time: (n + 1,) in which viscous moments of bending and twisting relax [s].
        clamp_length: (2,) length inside each grip that still bends [m]; negative: of the free
            length, that does not.
        marker_offset: (M, 3) of every marker from the centreline, components along (m1, m2, t) [m].
        roll: (2,) angle of the material frame against each grip's frame [rad].
        held_turn: (2, 2) turn of the centreline against the line through a grip's markers, about
            the grip's (m1, m2) [rad].
    """

    marker_node: np.ndarray
    mean_length: np.ndarray
    mean_tension: np.ndarray
    force: np.ndarray
    linear_drag: np.ndarray
    quadratic_drag: np.ndarray
    viscous_time: np.ndarray
    relaxation_time: np.ndarray
    clamp_length: np.ndarray
    marker_offset: np.ndarray
    roll: np.ndarray
    held_turn: np.ndarray

    # A rod that is r times as stiff as another of its kind is thicker by the cube root of r.
    stretching_power: ClassVar[float] = 1 / 3

    @classmethod
    def base(
        cls,
        edge_length: np.ndarray,
        subdivisions: int,
        gravity: float,
        tension: np.ndarray | None = None,
    ) -> MotionSetup:
        """A straight, uniform, isotropic rod without damping, as thick as a common cable.

        Args:
            edge_length: (n,) length of every edge, one inside each grip [m].
            subdivisions: edges between neighbouring free markers.
            gravity: [m/s^2], along -z.
            tension: (2, n) as `mean_tension`; default: none.
        """
        length = np.asarray(edge_length, dtype=float)
        nodes = np.concatenate([[0.0], np.cumsum(length)])
        n = len(nodes)
        place = np.array([0, *range(1, n - 1, subdivisions), n - 1])
        bending = 2.0 * gravity * START_L_GB**3  # k_b = 2 rho A g L_gb^3
        return cls.plain(
            (nodes - nodes[1]) / (nodes[-2] - nodes[1]),
            bending,
            bending / (1.0 + _POISSON),
            4.0 * bending / (SLENDER * START_L_GB) ** 2,
            1.0,
            gravity,
            marker_node=place,
            mean_length=length,
            mean_tension=np.zeros((2, len(length))) if tension is None else tension,
            force=np.zeros((n, 3)),
            linear_drag=np.zeros(n),
            quadratic_drag=np.zeros(n),
            viscous_time=np.zeros((n, 3)),
            relaxation_time=np.zeros(n),
            clamp_length=np.zeros(2),
            marker_offset=np.zeros((len(place), 3)),
            roll=np.zeros(2),
            held_turn=np.zeros((2, 2)),
        )

    @property
    def rest_length(self) -> np.ndarray:
        """(n,) what the edges are long without their mean tension [m].

        That tension is of a rod as heavy as it is long while it is stretched, so a share r of its
        length at rest is from r (1 + r tension / stretching) = 1.
        """
        by_load, by_bending = self.mean_tension
        tension = by_load + by_bending * self.bending.mean()
        return self.mean_length * 2.0 / (1.0 + np.sqrt(1.0 + 4.0 * tension / self.stretching))

    @property
    def node_length(self) -> np.ndarray:
        """(n + 1,) rest length that belongs to each node [m]."""
        return cells(self.rest_length)

    def _bending_cells(self) -> np.ndarray:
        """(n + 1,) what bends of each node's cell [m]: a grip's node has all inside the grip."""
        edge = self.rest_length.astype(complex)
        node = np.concatenate([[0.0], np.cumsum(edge)]) - edge[0]
        middle = 0.5 * (node[1:] + node[:-1])
        start, end = -self.clamp_length[0], node[-2] + self.clamp_length[1]
        first, last = np.r_[start, start, middle[1:]], np.r_[middle[:-1], end, end]
        # Ends are compared by their real parts: derivatives are of those that bound.
        return np.where(last.real > np.real(end), end, last) - np.where(
            first.real < np.real(start), start, first
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """What the kernels take, complex if the setup is, in the principal frame of bending.

        Only what of a node's cell is in the free length, or `clamp_length` beyond it, bends; where
        that is negative, the rod is rigid so far from the grip's inner marker.
        """
        length = self.node_length
        share = (self._bending_cells() / length).astype(complex)
        share[share.real < _RIGID] = _RIGID
        share[[0, -1]] = 1.0
        mass = self.line_mass * length + self.node_mass
        angle, offset = self.principal_angle, self.marker_offset
        here = self.on_mesh(self.rest_length, share)
        return {
            "rest_length": here["rest_length"],
            "stretching": here["stretching_stiffness"],
            "stiffness": np.c_[here["bending_stiffness"], here["twisting_stiffness"]],
            "rest_strain": np.c_[here["natural_curvature"], here["natural_twist"]],
            "viscous_time": np.c_[self.viscous_time, self.relaxation_time],
            "softening": here["softening"],
            **of_free_part(share, inelastic=self.inelastic),
            "mass": mass,
            "linear_drag": self.linear_drag * length,
            "quadratic_drag": self.quadratic_drag * length,
            "gravity": self.gravity + self.force,
            "marker_offset": np.c_[in_principal(offset[:, :2], angle), offset[:, 2]],
        }
