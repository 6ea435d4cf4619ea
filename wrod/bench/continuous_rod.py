"""A continuous Kirchhoff rod between two clamps by collocation (SciPy): no elements, no DER.

It makes measurements for identification that share no discretisation and no code with wrod's
solvers; wrod's shapes only serve as first guesses. Over unstretched arc length s run position q,
orientation (unit quaternion), force n and moment m of the part beyond s on the part before it:

    q' = (1 + n.t / EA) t,   R' = [k]x R,   n' = -f,   m' = -q' x n,
    k = R (m1 / B1 + k1, m2 / B2 + k2, m3 / GJ + twist),

or what a section with a coupling of bending and twist has in its place.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from wrod.bench.continuous_stability import conjugate_points, cross
from wrod.errors import DataError
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.loading import measurements_from_arrays
from wrod.identification.clamped.setup import ClampedSetup
from wrod.rods.law import Linear
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.rotation import node_frames, one_hemisphere


def constant(*values: float) -> Callable:
    """A profile along the rod that does not change."""
    return lambda s: np.array(values)[:, None] + 0.0 * s


def as_they_are(position: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Cameras that see the markers where they are."""
    return position


NO_MASS, NO_CURVATURE, NO_FORCE = constant(0.0), constant(0.0, 0.0), constant(0.0, 0.0, 0.0)
ISOTROPIC = constant(1.0, 1.0)
_SMALLEST_STEP = 0.02
# Solutions after the whole effect is there, in which what gives comes to rest.
_SETTLED = 6


@dataclass
class Experiment:
    """What the laboratory really holds; the defaults are the base model.

    Profiles take arc lengths (K,) and give (..., K).

    Attributes:
        bending: factors of (B1, B2), about directions turned from (m1, m2) by `principal` [rad];
            of what resists turning about them, not bending towards them.
        twisting, stretching: factors of GJ and EA; twist_profile, stretch_profile: such factors
            along the rod.
        curvature, twist: at rest, in the material frame [1/m], [rad/m]. Curvature is that of
            rotation vectors, the axis k that the tangent turns about: see `tangent_turn`.
        force: dead force per length beside the weight [N/m].
        drag: (q, t, s) -> force per length that follows the shape [N/m].
        mass: extra mass per length [kg/m].
        gravity_turn: rotation vector of gravity.
        slip: free length over the nominal one [m], at the gripper.
        clamp_turn, grip_turn: rotation vector in clamp A and gripper, or one for each trial (T, 3).
        clamp_shift, grip_shift: displacement there, in the reported frame [m].
        law: e -> (M / B, its derivative) of the curvature e >= 0 beyond that at rest; None: linear.
        coupling: of bending about (m1, m2) with twist, over sqrt(B GJ); linear rods only.
        see: what the cameras make of (T, M, 3) markers and (T, M, 3, 3) frames.
        clamp_give, grip_give: moment of the rod on what holds it, in the frame there (3,) [N m] ->
            rotation vector by which that turns.
        each: (trial, past) -> what is different in that trial, as fields of a experiment; past: arc
            lengths (K,) and curvatures (2, K) of the trial before, None at first; linear rods only.
    """

    bending: Callable = ISOTROPIC
    principal: float = 0.0
    twisting: float = 1.0
    twist_profile: Callable = np.ones_like
    stretching: float = 1.0
    stretch_profile: Callable = np.ones_like
    curvature: Callable = NO_CURVATURE
    twist: float = 0.0
    force: Callable = NO_FORCE
    drag: Callable | None = None
    mass: Callable = NO_MASS
    gravity_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    slip: float = 0.0
    clamp_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    grip_turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    clamp_shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    grip_shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    law: Callable | None = None
    coupling: np.ndarray = field(default_factory=lambda: np.zeros(2))
    see: Callable = as_they_are
    clamp_give: Callable | None = None
    grip_give: Callable | None = None
    each: Callable | None = None


def tangent_turn(axis) -> np.ndarray:
    """(2, ...) dt/ds along (m1, m2), as `wrod.RodModel` has it, of a curvature given as the axis k
    of dt/ds = k x t along (m1, m2)."""
    return np.stack([axis[1], -np.asarray(axis[0])])


def turn_axis(curvature) -> np.ndarray:
    """The inverse of `tangent_turn`."""
    return np.stack([-np.asarray(curvature[1]), curvature[0]])


def world_of(rod: RodModel, base: RodMaterial) -> Experiment:
    """The laboratory in which a piece of `rod` is clamped, seen from the base model."""
    first, second = rod.bending_stiffness
    line_mass = base.weight / base.gravity
    c, r = rod.law.softening

    def law(e):
        x = 1.0 + c * e * e
        return e * (r + (1.0 - r) / x), r + (1.0 - r) * (2.0 - x) / (x * x)

    return Experiment(
        # What resists bending towards one direction is about the other.
        bending=lambda s: np.stack([second(s), first(s)]) / base.bending_stiffness,
        principal=rod.principal_angle,
        twist_profile=lambda s: rod.twisting_stiffness(s) / base.twisting_stiffness,
        stretch_profile=lambda s: rod.stretching_stiffness(s) / base.stretching_stiffness,
        curvature=lambda s: turn_axis([k(s) for k in rod.natural_curvature]),
        twist=float(rod.natural_twist.mean(0.0, base.length)),
        mass=lambda s: (rod.line_mass(s) - line_mass)[None],
        law=None if isinstance(rod.law, Linear) else law,
    )


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
    return np.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + cross(a[1:], b[1:])])


def excess_of(moment: np.ndarray, stiffness: np.ndarray, law: Callable | None, share: float):
    """(2, K) curvatures beyond those at rest that carry (2, K) moments; Newton's method on
    (1 - share) e + share law(e) = size of moment over stiffness, sizes weighted by the stiffness as
    in the energy."""
    excess = moment / stiffness
    if law is None:
        return excess
    weight = stiffness / np.mean(stiffness, axis=0)
    size = np.sqrt((weight * excess**2).sum(axis=0)) + 1e-300
    e = size.copy()
    for _ in range(60):
        value, slope = law(e)
        away = (1 - share) * e + share * value - size
        change = away / (1 - share + share * slope)
        e = np.maximum(e - change, 0.5 * e)
        if np.all(np.abs(change) < 1e-12 * (1 + e)):
            break
    return excess * (e / size)


def derivatives_of(rhs: Callable) -> Callable:
    """Those of `rhs`, (s (K,), y (n, K)[, p (k,) or (k, K)]) -> (n, K), by its numbers, as SciPy's
    `solve_bvp` takes and would find them, by forward differences: (n, n, K), and (n, k, K) by p.
    All are moved at once, as for so few points a call costs more than what it does."""

    def derivatives(s, y, *p):
        z = np.concatenate([y, *(np.broadcast_to(one[:, None], (len(one), len(s))) for one in p)])
        n, i = len(y), np.arange(len(z))
        moved = np.repeat(z[:, None], len(z) + 1, axis=1)  # the last one stays
        moved[i, i] += np.sqrt(np.finfo(float).eps) * (1.0 + np.abs(z))
        step = moved[i, i] - z
        many = moved.reshape(len(z), -1)
        rates = rhs(np.tile(s, len(z) + 1), *np.split(many, [n])[: 1 + len(p)])
        rates = rates.reshape(n, len(z) + 1, len(s))
        out = (rates[:, :-1] - rates[:, -1:]) / step
        return (out[:, :n], out[:, n:]) if p else out

    return derivatives


def _coupled(moment, torque, bending, twisting, coupling) -> np.ndarray:
    """(3, K) curvatures and twist of a section whose bending and twisting are coupled."""
    section = np.zeros((moment.shape[1], 3, 3))
    section[:, 0, 0], section[:, 1, 1], section[:, 2, 2] = bending[0], bending[1], twisting
    section[:, :2, 2] = section[:, 2, :2] = coupling
    return np.linalg.solve(section, np.concatenate([moment, torque[None]]).T[:, :, None])[:, :, 0].T


def length_of(rod: RodMaterial, experiment: Experiment, share: float = 1.0) -> float:
    """Free length between the clamps [m]."""
    return rod.length + share * experiment.slip


def _curvature_of(rod: RodMaterial, experiment: Experiment, found) -> np.ndarray:
    """(2, K) curvatures of a linear, isotropic rod in its material frame [1/m]."""
    local = np.einsum("ijk,ik->jk", frames_of(found.y[3:7]), found.y[10:13])[:2]
    s = length_of(rod, experiment) * found.x
    return local / (rod.bending_stiffness * experiment.bending(s)) + experiment.curvature(s)


def _solve(rod, experiment: Experiment, share: float, a, ra, b, rb, guess, tolerance=1e-6):
    """(solution, right-hand side) of one trial with a share of the effect; (s, y) of the guess on
    the unit interval."""
    length = length_of(rod, experiment, share)
    k_b, k_s = rod.bending_stiffness, rod.stretching_stiffness * experiment.stretching**share
    k_t = rod.twisting_stiffness * experiment.twisting**share
    line = rod.weight / rod.gravity
    gravity = Rotation.from_rotvec(share * experiment.gravity_turn).apply([0, 0, -rod.gravity])
    c, d = np.cos(experiment.principal), np.sin(experiment.principal)
    principal = np.array([[c, d], [-d, c]])
    coupling = principal @ experiment.coupling * share * np.sqrt(k_b * k_t)

    def rhs(u, y):
        s = length * u
        r = frames_of(y[3:7])
        n, m = y[7:10], y[10:13]
        t = r[:, 2]
        local = np.einsum("ijk,ik->jk", r, m)
        stiffness = k_b * (1 + share * (experiment.bending(s) - 1))
        twisting = k_t * (1 + share * (experiment.twist_profile(s) - 1))
        if experiment.coupling.any():
            strain = _coupled(principal @ local[:2], local[2], stiffness, twisting, coupling)
            bend, turn = principal.T @ strain[:2], strain[2]
        else:
            bend = principal.T @ excess_of(principal @ local[:2], stiffness, experiment.law, share)
            turn = local[2] / twisting
        bend = bend + share * experiment.curvature(s)
        turn = turn + share * experiment.twist
        k = np.einsum("ijk,jk->ik", r, np.concatenate([bend, turn[None]]))
        stretching = k_s * (1 + share * (experiment.stretch_profile(s) - 1))
        dq = (1 + (n * t).sum(axis=0) / stretching) * t
        force = gravity[:, None] * (line + share * experiment.mass(s)) + share * experiment.force(s)
        if experiment.drag is not None:
            force = force + share * experiment.drag(y[:3], t, s)
        zero = np.zeros_like(k[:1])
        spin = 0.5 * product(np.concatenate([zero, k]), y[3:7])
        # Keep the quaternion's length where it is.
        return length * np.concatenate([dq, spin, -force, -cross(dq, n)])

    qa = np.roll(Rotation.from_matrix(ra).as_quat(), 1)
    qb = np.roll(Rotation.from_matrix(rb).as_quat(), 1)
    qa = qa if qa @ guess[1][3:7, 0] >= 0 else -qa
    inverse = qb * [1, -1, -1, -1]

    def ends(y0, y1):
        left = product(inverse[:, None], y1[3:7, None])[1:, 0]
        return np.concatenate([y0[:3] - a, y0[3:7] - qa, y1[:3] - b, left])

    derivatives = derivatives_of(rhs)
    found = solve_bvp(rhs, ends, *guess, fun_jac=derivatives, tol=tolerance, max_nodes=4000)
    if not found.success:
        raise DataError(f"collocation finds no equilibrium of the clamped rod: {found.message}")
    return found, rhs


def _first_guesses(measurements):
    """wrod's base solution of every trial as (u, y)."""
    trials = np.arange(measurements.trial_count)
    setup = ClampedSetup.base(measurements, trials, 60)
    solver = ClampedSolver([setup])
    seen = solver.predict([setup])
    positions = solver.batch.positions()[:, 1:-1]
    directors, tangents = solver.batch.material_directors(), solver.batch.state.tangent.numpy()
    frames = node_frames(directors[:, :, 0], tangents)[:, 1:-1]
    return [
        _guess_of(measurements.material, positions[i], frames[i], np.real(seen.force[0, i]))
        for i in trials
    ]


def _guess_of(rod: RodMaterial, position, matrices, force):
    """(u, y) of one rod: nodes (n + 1, 3), their frames (n + 1, 3, 3), the gripper's force."""
    edge_count = len(position) - 1
    rotation = Rotation.from_matrix(matrices)
    quaternion = one_hemisphere(np.roll(rotation.as_quat(), 1, axis=1))
    u = np.linspace(0.0, 1.0, edge_count + 1)
    curvature = (rotation[1:] * rotation[:-1].inv()).as_rotvec() * edge_count / rod.length
    curvature = np.concatenate([curvature[:1], 0.5 * (curvature[1:] + curvature[:-1])])
    curvature = np.concatenate([curvature, curvature[-1:]])
    local = np.einsum("kij,ki->kj", matrices, curvature)
    local *= [rod.bending_stiffness, rod.bending_stiffness, rod.twisting_stiffness]
    m = np.einsum("kij,kj->ki", matrices, local)
    n = force - np.outer(rod.weight * rod.length * (1 - u), [0, 0, 1])
    return u, np.concatenate([position, quaternion, n, m], axis=1).T


def measured(
    data: dict[str, Any],
    experiment: Experiment,
    *,
    seed: int = 0,
    noise: float = 5e-4,
    wrench_noise: bool = True,
    steps: int = 10,
) -> dict[str, Any]:
    """A set of measurements of the rod and at the poses in `data` (fields of a measured file).

    Args:
        data: everything but what is measured.
        experiment: what the rod is really like.
        seed, noise: of marker coordinates [m]; wrench_noise: whether the wrist sensor has its own.
        steps: in which the effect grows from nothing, so that rods stay on their branch; halved
            where a rod does not follow.

    Raises:
        DataError: a trial finds no equilibrium, or an unstable one (what holds it being rigid).
    """
    trials = len(data["clamp_position"])
    line = (
        data["clamp_position"][:, None]
        + (data["arc_length"] / data["length"])[:, None]
        * ((data["grip_position"] - data["clamp_position"])[:, None])
    )
    m = measurements_from_arrays({**data, "centerline": line})
    rod: RodMaterial = m.material
    positions, frames, forces, torques = [], [], [], []
    guesses = _first_guesses(m)

    def held(end, i, share, guess):
        turn = np.broadcast_to(getattr(experiment, f"{end}_turn"), (trials, 3))[i]
        position, rotation = (getattr(m, f"{end}_{part}")[i] for part in ("position", "rotation"))
        shift = rotation @ getattr(experiment, f"{end}_shift")
        if give := getattr(experiment, f"{end}_give"):
            moment = guess[1][10:13, 0] if end == "clamp" else -guess[1][10:13, -1]
            turn = turn + give(rotation.T @ moment)
        return position + share * shift, rotation @ Rotation.from_rotvec(share * turn).as_matrix()

    past = None
    gives = experiment.clamp_give is not None or experiment.grip_give is not None
    for i in range(trials):
        own = replace(experiment, **experiment.each(i, past)) if experiment.each else experiment
        guess, share, step, settled = guesses[i], 0.0, 1.0 / steps, 0 if gives else _SETTLED
        while share < 1.0 or settled < _SETTLED:
            ahead = share + step if share + step < 1.0 - 1e-9 else 1.0
            (a, ra), (b, rb) = held("clamp", i, ahead, guess), held("grip", i, ahead, guess)
            tolerance = 1e-6 if ahead == 1.0 else 1e-4
            try:
                # On the way a rough solution keeps to the branch as well.
                found, rhs = _solve(rod, own, ahead, a, ra, b, rb, guess, tolerance)
            except DataError:
                step *= 0.5
                if step < _SMALLEST_STEP:
                    raise
                continue
            settled += share == 1.0
            guess, share = (found.x, found.y), ahead
        if not gives and conjugate_points(rhs, found.sol):
            raise DataError(f"trial {i} comes to an equilibrium that no rod keeps")
        if experiment.each:
            past = length_of(rod, own) * found.x, _curvature_of(rod, own, found)
        length = length_of(rod, own)
        y = found.sol(np.minimum(m.arc_length / length, 1.0))
        # What has slipped into the gripper lies straight in it.
        inside = np.maximum(m.arc_length - length, 0.0)
        positions.append(y[:3].T + inside[:, None] * frames_of(y[3:7])[:, 2].T)
        frames.append(np.moveaxis(frames_of(y[3:7]), 2, 0))
        forces.append(found.y[7:10, -1])
        torques.append(found.y[10:13, -1])
    rng = np.random.default_rng(seed)
    position = experiment.see(np.array(positions), np.array(frames))
    position = position + noise * rng.normal(size=position.shape)
    wrench = {"grip_force": (np.array(forces), 2e-3), "grip_torque": (np.array(torques), 2e-4)}
    if wrench_noise:
        for values, least in wrench.values():
            values += np.hypot(0.02 * values, least) * rng.normal(size=values.shape)
    return {**data, "centerline": position} | {key: values for key, (values, _) in wrench.items()}
