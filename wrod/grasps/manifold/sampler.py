"""Leads rods over the manifold of grasps and reads them out as grids. Dimensionless."""

from dataclasses import dataclass

import numpy as np

from wrod.grasps.held_rods import HeldRods
from wrod.grasps.manifold.boundary import EMPTY, TOUCHES, Boundary, Rays
from wrod.grasps.manifold.grips import in_chunks
from wrod.grasps.nudge import PARTED, parting

_NUDGE = 1e-3
_LEVELS, _RADII = 12, 12
# A ray this far beyond the first overhanging one is where the overhang is entered.
_ENTRY = np.radians(6.0)
# The low edge falls by more than this between two rays where an overhang begins [L_gb].
_OVERHANG = 0.2
_TURN = np.radians(0.25)


@dataclass(frozen=True)
class Patch:
    """A part of the manifold as a grid of grips that are neighbours in both directions.

    position (a, b, 2) is (x, z) of the grip, force (a, b, 3), eigenvalue (a, b) that of the softest
    motion (negative is unstable), snaps (a, b) whether a nudge of 1e-3 makes the rod leave its
    branch, deflection (a, b) the largest |y| under the sideways offset, and shape (a, b, node, 3)
    the rod. The last column is the low edge, where the rod dips.
    """

    position: np.ndarray
    force: np.ndarray
    eigenvalue: np.ndarray
    snaps: np.ndarray
    deflection: np.ndarray
    shape: np.ndarray


class Sampler:
    """Leads rods over the manifold and reads them out."""

    def __init__(self, length, ratio, start, offset, device, threads):
        self.length, self.ratio, self.start, self.offset = length, ratio, start, offset
        self.device, self.threads = device, threads

    def _rods(self, count: int) -> HeldRods:
        return HeldRods(
            np.full(count, self.length),
            np.full(count, self.ratio),
            np.repeat(self.start[None], count, axis=0),
            device=self.device,
        )

    def seen(self, edge: Boundary) -> Patch:
        """What the rays see: from the tight end of each to its low end."""
        full = edge.kind[0] != EMPTY
        angle, tight, low = edge.angle[full], edge.tight[0, full], edge.low[0, full]
        # Finer towards the ends, where fields bend most.
        level = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _LEVELS))

        def solve(chunk: slice):
            rays = Rays(self._rods(len(angle[chunk])), angle[chunk])
            rays.pull_taut()
            columns = []
            for u in level:
                radius = tight[chunk] + u * (low[chunk] - tight[chunk])
                rays.move(radius, np.ones(len(radius), dtype=bool))
                columns.append(rays.rods.shape())
            return np.stack(columns, axis=1)

        return self._patch(np.concatenate(in_chunks(solve, len(angle), self.device, self.threads)))

    def overhang(self, edge: Boundary) -> Patch | None:
        """Below the fold that ends the rays: from an overhanging ray back along circles.

        Where the rod leans over backwards, rays end because the far side of its arch comes down to
        the table, and not because the rod dips at the contact. Back from there, on circles about
        the contact, the manifold goes on beneath the part that the rays see.
        """
        angle, low = edge.angle, edge.low[0]
        touching = np.flatnonzero((edge.kind[0, 1:] == TOUCHES) & (np.diff(low) < -_OVERHANG))
        if not touching.size:
            return None
        first = int(touching[0]) + 1
        beyond = np.flatnonzero(angle >= angle[first] + _ENTRY)
        if not beyond.size:
            return None
        entry = beyond[0]
        # The arch's far side: its low edge as a line over the angle, on to where no ray sees it.
        slope, base = np.polyfit(angle[first : entry + 1], low[first : entry + 1], 1)
        bottom = base + slope * (angle[first] - _ENTRY) if slope > 0.0 else low[entry]
        if abs(slope) < 1e-6 or bottom >= low[first - 1]:
            return None
        radius = np.linspace(bottom, low[first - 1], 2 * _RADII)
        touch = (radius - base) / slope
        begin = (
            np.minimum(angle[entry], touch) if slope > 0.0 else np.full_like(touch, angle[entry])
        )

        def enter() -> HeldRods:
            rods = self._rods(len(radius))
            rays = Rays(rods, np.full(len(radius), angle[entry]))
            rays.pull_taut()
            rays.move(radius, np.ones(len(radius), dtype=bool))
            return rods

        rods = enter()
        end = _turn_until_flat(rods, radius, angle[entry])
        if slope < 0.0:
            end = np.maximum(end, touch)
        real = begin > end + 1e-6
        radius, begin, end = radius[real], begin[real], end[real]
        if len(radius) < 2:
            return None
        rods = enter()
        columns = []
        for u in np.linspace(0.0, 1.0, _LEVELS):
            rods.continue_to(_on_circle(radius, begin + u * (end - begin)))
            columns.append(rods.shape())
        return self._patch(np.stack(columns, axis=1))

    def _patch(self, shape: np.ndarray) -> Patch:
        """Forces, eigenvalues and sideways deflections at (a, b, node, 3) equilibria."""
        a, b, nodes, _ = shape.shape
        flat = shape.reshape(a * b, nodes, 3)

        def solve(chunk: slice):
            rods = self._rods(len(flat[chunk]))
            rods.reset(flat[chunk])
            grip = rods.grip_position()
            rods.continue_to(grip)
            force = rods.force()
            eigenvalue = rods.eigenvalue()
            sideways = np.array([0.0, 1.0, 0.0])
            # The branch under the same nudge, whether or not a rod would stay on it.
            branch = self._rods(len(grip))
            branch.reset(rods.shape())
            branch.continue_to(grip)
            arrived = branch.continue_to(grip + _NUDGE * sideways)
            rods.settle(grip + _NUDGE * sideways)
            snaps = ~arrived | (parting(rods.shape(), branch.shape()) > PARTED)
            rods.settle(grip + self.offset * sideways)
            return force, eigenvalue, snaps, np.abs(rods.shape()[:, :, 1]).max(axis=1)

        parts = in_chunks(solve, len(flat), self.device, self.threads)
        force, eigenvalue, snaps, deflection = (np.concatenate(x) for x in zip(*parts, strict=True))
        return Patch(
            shape[:, :, -1][:, :, [0, 2]].copy(),
            force.reshape(a, b, 3),
            eigenvalue.reshape(a, b),
            snaps.reshape(a, b),
            deflection.reshape(a, b),
            shape,
        )


def _turn_until_flat(rods: HeldRods, radius: np.ndarray, angle: float) -> np.ndarray:
    """(n,) angles at which the rods lie flat at the contact, turning back from `angle`.

    A fold may be close behind: a rod that is lost goes on in smaller steps.
    """
    here, step = np.full(len(radius), angle), np.full(len(radius), _TURN)
    bend = rods.moment()[:, 1]
    pending = bend > 0.0
    for _ in range(400):
        if not pending.any():
            break
        there = here - step
        arrived = rods.continue_to(_on_circle(radius, there), pending) & pending
        new = rods.moment()[:, 1]
        crossed = arrived & (new <= 0.0)
        share = np.where(crossed, bend / np.where(crossed, bend - new, 1.0), 1.0)
        here = np.where(arrived, here - share * step, here)
        bend = np.where(arrived, new, bend)
        step = np.where(pending & ~arrived, 0.5 * step, step)
        pending &= ~crossed & (step > _TURN / 50.0)
    return here


def _on_circle(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return radius[:, None] * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
