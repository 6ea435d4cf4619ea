"""A continuous Kirchhoff rod between two clamps by collocation (SciPy): no elements, no DER.

It makes measurements for identification that share no discretisation and no code with wrod; wrod's
shapes only serve as first guesses. State: position q, orientation (unit quaternion), force n and
moment m of the part beyond s on the part before it, over unstretched arc length s:

    q' = (1 + n.t / EA) t,   R' = [k]x R,   n' = -f,   m' = -q' x n,
    k = R (m1 / B1 + k1, m2 / B2 + k2, m3 / GJ + twist).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from wrod.identification.clamped import ClampedSolver
from wrod.identification.measurements import measurements_from_arrays
from wrod.identification.setup import Setup
from wrod.material import RodMaterial


def constant(*values: float) -> Callable:
    """A profile along the rod that does not change."""
    return lambda s: np.array(values)[:, None] + 0.0 * s


def as_they_are(position: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Cameras that see the markers where they are."""
    return position


NO_MASS, NO_CURVATURE, NO_FORCE = constant(0.0), constant(0.0, 0.0), constant(0.0, 0.0, 0.0)
ISOTROPIC = constant(1.0, 1.0)


@dataclass
class World:
    """What the laboratory really holds; the defaults are the base model.

    Profiles take arc lengths (K,) and give (..., K).

    Attributes:
        bending: factors of (B1, B2); twisting: factor of GJ.
        curvature, twist: at rest, in the material frame [1/m], [rad/m].
        force: dead force per length beside the weight [N/m].
        drag: (q, t, s) -> force per length that follows the shape [N/m].
        mass: extra mass per length [kg/m].
        gravity_turn: rotation vector of gravity.
        slip: free length over the nominal one [m], at the gripper.
        grip_turn: rotation vector in the gripper, or one for each trial (T, 3).
        softening: (c, r) of the moment B e (r + (1 - r) / (1 + c e^2)).
        see: what the cameras make of (T, M, 3) markers and (T, M, 3, 3) frames.
    """

    bending: Callable = ISOTROPIC
    twisting: float = 1.0
    stretching: float = 1.0
    curvature: Callable = NO_CURVATURE
    twist: float = 0.0
    force: Callable = NO_FORCE
    drag: Callable | None = None
    mass: Callable = NO_MASS
    gravity_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    slip: float = 0.0
    grip_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    softening: tuple[float, float] = (0.0, 1.0)
    see: Callable = as_they_are


def frames_of(q: np.ndarray) -> np.ndarray:
    """(3, 3, K) rotation matrices of (4, K) quaternions (w, x, y, z), normalised."""
    w, x, y, z = q / np.sqrt((q * q).sum(axis=0))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of quaternions (4, K)."""
    w = a[0] * b[0] - (a[1:] * b[1:]).sum(axis=0)
    return np.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:], axis=0)])


def excess_of(moment: np.ndarray, stiffness: np.ndarray, softening) -> np.ndarray:
    """(2, K) curvatures beyond those at rest that carry (2, K) moments."""
    excess = moment / stiffness
    c, kept = softening
    if c == 0.0:
        return excess
    size = np.sqrt((excess**2).sum(axis=0)) + 1e-300
    e = size.copy()
    for _ in range(60):
        one = 1 + c * e * e
        value = e * (kept + (1 - kept) / one) - size
        e = np.maximum(e - value / (kept + (1 - kept) * (2 - one) / one**2), 0.5 * e)
    return excess * (e / size)


def _solve(rod, world: World, share: float, a, ra, b, rb, guess):
    """One trial with a share of the effect; (s, y) of the guess on the unit interval."""
    length = rod.length + share * world.slip
    k_b, k_s = rod.bending_stiffness, rod.stretching_stiffness * world.stretching**share
    k_t = rod.twisting_stiffness * world.twisting**share
    line = rod.weight / rod.gravity
    gravity = Rotation.from_rotvec(share * world.gravity_turn).apply([0, 0, -rod.gravity])
    kept = 1 - share * (1 - world.softening[1])

    def rhs(u, y):
        s = length * u
        r = frames_of(y[3:7])
        n, m = y[7:10], y[10:13]
        t = r[:, 2]
        local = np.einsum("ijk,ik->jk", r, m)
        stiffness = k_b * (1 + share * (world.bending(s) - 1))
        bend = excess_of(local[:2], stiffness, (world.softening[0], kept))
        bend = bend + share * world.curvature(s)
        turn = local[2] / k_t + share * world.twist
        k = np.einsum("ijk,jk->ik", r, np.concatenate([bend, turn[None]]))
        dq = (1 + (n * t).sum(axis=0) / k_s) * t
        force = gravity[:, None] * (line + share * world.mass(s)) + share * world.force(s)
        if world.drag is not None:
            force = force + share * world.drag(y[:3], t, s)
        zero = np.zeros_like(k[:1])
        spin = 0.5 * product(np.concatenate([zero, k]), y[3:7])
        # Keep the quaternion's length where it is.
        return length * np.concatenate([dq, spin, -force, -np.cross(dq, n, axis=0)])

    qa = np.roll(Rotation.from_matrix(ra).as_quat(), 1)
    qb = np.roll(Rotation.from_matrix(rb).as_quat(), 1)
    qa = qa if qa @ guess[1][3:7, 0] >= 0 else -qa
    inverse = qb * [1, -1, -1, -1]

    def ends(y0, y1):
        left = product(inverse[:, None], y1[3:7, None])[1:, 0]
        return np.concatenate([y0[:3] - a, y0[3:7] - qa, y1[:3] - b, left])

    found = solve_bvp(rhs, ends, *guess, tol=1e-6, max_nodes=4000)
    assert found.success, found.message
    return found


def _first_guess(measurements, trial: int, edge_count: int = 40):
    """wrod's base solution as (u, y)."""
    setup = Setup.base(measurements, np.array([trial]), edge_count)
    solver = ClampedSolver([setup])
    seen = solver.predict([setup])
    position = solver.batch.positions()[0, 1:-1]
    t = solver.batch.state.tangent.numpy()[0]
    d = solver.batch.material_directors()[0, :, 0]
    t, d = t[1:] + t[:-1], d[1:] + d[:-1]
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    d -= (d * t).sum(axis=1, keepdims=True) * t
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    matrices = np.stack([d, np.cross(t, d), t], axis=2)
    rotation = Rotation.from_matrix(matrices)
    quaternion = np.roll(rotation.as_quat(), 1, axis=1)
    for i in range(1, len(quaternion)):
        if quaternion[i] @ quaternion[i - 1] < 0:
            quaternion[i] *= -1
    rod = measurements.material
    u = np.linspace(0.0, 1.0, edge_count + 1)
    curvature = (rotation[1:] * rotation[:-1].inv()).as_rotvec() * edge_count / rod.length
    curvature = np.concatenate([curvature[:1], 0.5 * (curvature[1:] + curvature[:-1])])
    curvature = np.concatenate([curvature, curvature[-1:]])
    local = np.einsum("kij,ki->kj", matrices, curvature)
    local *= [rod.bending_stiffness, rod.bending_stiffness, rod.twisting_stiffness]
    m = np.einsum("kij,kj->ki", matrices, local)
    n = np.real(seen.force[0, 0]) - np.outer(rod.weight * rod.length * (1 - u), [0, 0, 1])
    return u, np.concatenate([position, quaternion, n, m], axis=1).T


def measured(
    data: dict[str, np.ndarray],
    world: World,
    *,
    seed: int = 0,
    noise: float = 5e-4,
    steps: int = 3,
) -> dict[str, np.ndarray]:
    """A set of measurements of the rod and at the poses in `data` (fields of a measured file)."""
    trials = len(data["clamp_position"])
    line = (
        data["clamp_position"][:, None]
        + (data["arc_length"] / data["length"])[:, None]
        * ((data["grip_position"] - data["clamp_position"])[:, None])
    )
    m = measurements_from_arrays({**data, "centerline": line})
    rod: RodMaterial = m.material
    turns = np.broadcast_to(world.grip_turn, (trials, 3))
    positions, frames, forces, torques = [], [], [], []
    for i in range(trials):
        guess = _first_guess(m, i)
        for step in range(1, steps + 1):
            share = step / steps
            turned = m.grip_rotation[i] @ Rotation.from_rotvec(share * turns[i]).as_matrix()
            found = _solve(
                rod,
                world,
                share,
                m.clamp_position[i],
                m.clamp_rotation[i],
                m.grip_position[i],
                turned,
                guess,
            )
            guess = found.x, found.y
        y = found.sol(m.arc_length / (rod.length + world.slip))
        positions.append(y[:3].T)
        frames.append(np.moveaxis(frames_of(y[3:7]), 2, 0))
        forces.append(found.y[7:10, -1])
        torques.append(found.y[10:13, -1])
    rng = np.random.default_rng(seed)
    position = world.see(np.array(positions), np.array(frames))
    force, torque = np.array(forces), np.array(torques)
    return {
        **data,
        "centerline": position + noise * rng.normal(size=position.shape),
        "grip_force": force + np.hypot(0.02 * force, 2e-3) * rng.normal(size=force.shape),
        "grip_torque": torque + np.hypot(0.02 * torque, 2e-4) * rng.normal(size=torque.shape),
    }
