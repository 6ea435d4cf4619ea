"""The overhand knot, pulled: simulation, and the law of its force for thin rods.

Units: radius of the section 1, bending stiffness 1, mass per length 1.

Law (Audoly, Clauvelin, Neukirch 2007; Jawed, Dieleman, Audoly, Reis 2015, whose knot with one
crossing more is this one): pulling the ends apart by d shortens a circular loop of radius R by d,
which stores bending energy pi B / R, and lets the two strands of the braid slide on each other by
d against mu times their total contact force P = c B h^(-1/2) R^(-3/2), so that

    T h^2 / B = e^4 / 2 + c mu e^3,    e = sqrt(h / R),

for tightening with friction mu, h the radius of the section, as e goes to 0. The braid's own energy
E B h^(1/2) R^(-3/2) adds the next order without friction, 3 E e^5 / (4 pi). `solve_braid` gives c
and E.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.errors import GraspError
from wrod.patterns.curve import arc_length
from wrod.rods.batch import RodBatch
from wrod.rods.model import RodModel
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.statics import prescribe

# Part of the loosest loop's radius that a knot is pulled by before it is looked at.
RUN_IN = 0.3
# And after it came to rest on the way.
_ONCE_MORE = 0.05


def solve_braid(points: int = 161) -> tuple[float, float]:
    """Total contact force c between the strands of the braid, in units of B h^(-1/2) R^(-3/2), and
    its energy E beyond that of strands without thickness, in units of B h^(1/2) R^(-3/2).

    In a thin, loose knot the strands run at +-U(X) from their mean, with small slopes, in units of
    h across and sqrt(h R) along: U'''' = P n where they touch at |U| = 1. Far out one strand is
    straight and the other has the loop's curvature, U'' = +-1/2; U turns by 3 half turns between
    the ends of the braid (its 3 crossings). Solved as the least of the energy with a stiff contact.
    """
    x = np.linspace(-8.0, 8.0, points)
    stiffness = 1e4
    n, h = points, x[1] - x[0]
    second = np.diff(np.eye(n), 2, axis=0) / h**2
    bending = h * second.T @ second
    moment = np.zeros(n)
    moment[[0, 1, -2, -1]] = np.array([-0.5, 0.5, -0.5, 0.5]) / h
    angle = np.pi + 3 * np.pi * np.clip(0.5 + x / 8, 0, 1)
    size = 1.01 + np.maximum(np.abs(x) - 4, 0) ** 2 / 4
    u = size * np.stack([np.cos(angle), np.sin(angle)])

    def energy(u, k):
        depth = np.maximum(1 - np.hypot(*u), 0)
        return (
            0.5 * np.einsum("ai,ij,aj", u, bending, u) - moment @ u[0] + k * h * depth @ depth / 2
        )

    k, shift = 10.0, 1e-3
    while k <= stiffness:
        for _ in range(400):
            size = np.hypot(*u)
            depth, normal = np.maximum(1 - size, 0), u / size
            gradient = u @ bending - k * h * depth * normal
            gradient[0] -= moment
            if np.abs(gradient).max() < 1e-7:
                break
            hessian = np.kron(np.eye(2), bending)
            nn = normal[:, None] * normal[None]
            turning = (np.eye(2)[:, :, None] - nn) * (depth / size)
            block = k * h * ((depth > 0) * nn - turning)
            for a, b in np.ndindex(2, 2):
                hessian[a * n : a * n + n, b * n : b * n + n] += np.diag(block[a, b])
            # Levenberg: a descent that no strand can jump through.
            while True:
                matrix = hessian + shift * np.eye(2 * n)
                if np.linalg.eigvalsh(matrix)[0] > 0:
                    step = -np.linalg.solve(matrix, gradient.ravel()).reshape(2, n)
                    lower = energy(u + step, k) <= energy(u, k) + 1e-12
                    if np.abs(step).max() < 0.3 and lower:
                        break
                shift = max(4 * shift, 1e-10)
                if shift > 1e12:
                    raise GraspError("the braid of the overhand knot was not found")
            u, shift = u + step, max(0.1 * shift, 1e-14)
        k *= 10
    k /= 10
    contact = k * h * np.maximum(1 - np.hypot(*u), 0).sum()
    # Both strands; without thickness each half of the braid, 8 long, has -1.
    return float(contact), float(2 * (energy(u, k) + 2.0))


def knot_force(
    radius: np.ndarray, friction: float, contact: float, energy: float = 0.0
) -> np.ndarray:
    """T h^2 / B at loop radius R / h, by the law above; with the braid's energy, its next order."""
    e = np.sqrt(1 / np.asarray(radius))
    return e**4 / 2 + contact * friction * e**3 + 0.75 / np.pi * energy * e**5


def open_trefoil(shortening: float, tail: float, spacing: float) -> np.ndarray:
    """(node, 3) an overhand knot whose ends are `shortening` closer than its length; straight
    tails, edges of length `spacing` up to rounding."""
    t = np.linspace(-2.12, 2.12, 4000)
    curve = np.column_stack([t**3 - 3 * t, 0.8 * (t**4 - 4 * t**2), 0.16 * (t**5 - 10 * t)])
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    extent = np.linalg.norm(curve[-1] - curve[0])
    curve *= shortening / (length - extent)
    first, last = curve[0] - curve[1], curve[-1] - curve[-2]
    run = np.linspace(0, tail, 400)[1:, None]
    before = curve[0] + run[::-1] * first / np.linalg.norm(first)
    after = curve[-1] + run * last / np.linalg.norm(last)
    curve = np.concatenate([before, curve, after])
    arc = arc_length(curve)
    even = np.linspace(0, arc[-1], round(arc[-1] / spacing) + 1)
    return np.column_stack([np.interp(even, arc, curve[:, c]) for c in range(3)])


@dataclass(frozen=True)
class Pull:
    """An overhand knot, pulled tight: (frame, rod) arrays, in units of radius and stiffness.

    Attributes:
        radius: end-to-end shortening over 2 pi, R / h.
        force: T h^2 / B at the ends.
        contact: total normal force N h^2 / B between the strands.
        penetration: deepest, over the radius of the section.
        position: (frame, rod, node, 3) configurations.
    """

    radius: np.ndarray
    force: np.ndarray
    contact: np.ndarray
    penetration: np.ndarray
    position: np.ndarray


class _Ends:
    """Moves both end nodes apart, each by half, from the time `start` on."""

    def __init__(self, batch: RodBatch, speed: float):
        self.batch, self.speed = batch, speed
        self.stop()
        along = self.ends[:, 1] - self.ends[:, 0]
        self.direction = along / np.linalg.norm(along, axis=1)[:, None]
        prescribe(batch, pinned_nodes=(0, -1))

    def stop(self) -> None:
        """Stand still where the ends are."""
        self.start = np.inf
        self.ends = self.batch.positions()[:, [0, -1]].copy()

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start) -> None:
        dof = self.batch.state.dof.numpy().copy()
        now = running.numpy() != 0
        moved = 0.5 * self.speed * np.maximum(time.numpy() + step.numpy() - self.start, 0)
        way = moved[:, None] * self.direction
        dof[now, :3] = (self.ends[:, 0] - way)[now]
        dof[now, -3:] = (self.ends[:, 1] + way)[now]
        self.batch.state.dof.assign(dof)


def _loose_knots(count: int, radius: float, spacing: float) -> RodBatch:
    """Overhand knots of a loop of that radius, of nodes that far apart, in radii of section."""
    position = open_trefoil(2 * np.pi * radius, 2 * radius, spacing)
    edge = np.linalg.norm(np.diff(position, axis=0), axis=1)
    arc_length = np.concatenate([[0.0], np.cumsum(edge)])
    rod = RodModel(
        length=arc_length[-1],
        bending_stiffness=1.0,
        twisting_stiffness=1 / 1.5,
        stretching_stiffness=40.0,  # inextensible against the tension of a knot
        line_mass=1.0,
        radius=1.0,
    )
    places = np.repeat(position[None], count, axis=0)
    return RodBatch.of(rod, arc_length, places, gravity=(0.0, 0.0, 0.0))


def pull(
    friction: list[float],
    *,
    loosest: float = 60.0,
    tightest: float = 10.0,
    frames: int = 28,
    spacing: float = 2.2,
    stiffness: float = 2.0,
    slowness: float = 0.3,
) -> Pull:
    """Pull overhand knots with these coefficients of friction, from loop radius `loosest` to
    `tightest` (over the section's), in `slowness` periods R^2 of the loop per radius of section.

    Knots find their first shape without friction, which would keep slack in their tails. They
    start looser by `RUN_IN`, are pulled until they slide, and come to rest once more, for their
    tails to stop swinging, before anything is recorded."""
    start = (1.0 + RUN_IN) * loosest
    speed, period = 1 / (slowness * loosest**2), loosest**2
    batch = _loose_knots(len(friction), start, spacing)
    smooth, rough = (
        RodContact(batch, 1.0, [Friction(f) for f in coefficients], stiffness=stiffness)
        for coefficients in ([0.0] * len(friction), friction)
    )
    ends = _Ends(batch, speed)

    def dynamics(contact: RodContact, air_damping: float) -> Dynamics:
        return Dynamics(
            batch,
            scheme="euler",
            radius=1.0,
            contact=contact,
            air_damping=air_damping / period,
            internal_damping=0.3 * period,
            motion=ends,
            force_scale=1.0 / loosest**2,
            tolerance=1e-5,
        )

    dynamics(smooth, 2.0).advance(25 * period, 0.05 * period)
    contact, pulled = rough, dynamics(rough, 0.1)
    length = batch.rest_length.numpy().sum(axis=1)
    # Tails lie slanted at first, so that the ends are nearer than the loop's size says.
    first = (length - np.linalg.norm(ends.ends[:, 1] - ends.ends[:, 0], axis=1)).max() / (2 * np.pi)
    ends.start, now = 0.0, 2 * np.pi * (first - (1 + _ONCE_MORE) * loosest) / speed
    pulled.advance(now, 0.25 / speed)
    ends.stop()
    pulled.air_damping.fill_(2.0 / period)
    now += 25 * period
    pulled.advance(now, 0.05 * period)
    ends.start = now
    now += 2 * np.pi * _ONCE_MORE * loosest / speed
    pulled.air_damping.fill_(0.02 / period)
    radii, forces, normals, depths, shapes = [], [], [], [], []
    duration = 2 * np.pi * (loosest - tightest) / speed
    for part in np.linspace(0, 1, frames):
        pulled.advance(now + part * duration, 0.25 / speed)
        q = batch.positions()
        force = batch.evaluate(order=1).gradient.numpy().reshape(len(friction), -1)
        tension = force[:, -3:] - force[:, :3]
        radii.append((length - np.linalg.norm(q[:, -1] - q[:, 0], axis=1)) / (2 * np.pi))
        forces.append(0.5 * np.einsum("ra,ra->r", tension, ends.direction))
        normals.append(contact.load.numpy().sum(axis=(1, 2)))
        depths.append(contact.penetration.numpy().copy())
        shapes.append(q.copy())
    return Pull(
        np.array(radii),
        np.array(forces),
        np.array(normals),
        np.array(depths),
        np.array(shapes),
    )
