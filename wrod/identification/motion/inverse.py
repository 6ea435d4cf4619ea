"""Inverse dynamics: the forces at the markers that a model lacks to follow recorded motion, as
docs/identification-motion.md tells.

Every sampled frame is a statics problem by d'Alembert's principle, in which nodes between markers
find their equilibrium. What is looked at are combinations of reactions that do not feel the tension
of any span, for the lengths between markers are not known nearly as well as a rod resists
stretching.
"""

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from wrod.identification.effect import Model
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.smoothing import sampled_frames, smoothed, smoothing
from wrod.identification.motion.start import held_ends, rods_on_mesh
from wrod.identification.motion.tangents import (
    COMPLEX_STEP,
    ELASTIC,
    node_columns,
    rates_of,
    uploaded,
)
from wrod.identification.motion.windows import Windows
from wrod.kernels.stepping import motion_tangents, observed_tangents
from wrod.rods.batch import RodBatch
from wrod.rods.rotation import angle_about, node_frames, transport, unit
from wrod.solvers.banded import BandedSystem, multiply_banded
from wrod.solvers.statics import EquilibriumSolver, prescribe
from wrod.solvers.steps import unit_pace

# Rounds in which the tensions and the shapes between markers settle, and what is expected of the
# missing force meanwhile, over the weight.
_ROUNDS, _EXPECTED = 3, 0.1
_TOLERANCE = 1e-8


@dataclass
class InverseMotion:
    """S sampled frames; n nodes, F free markers, D degrees of freedom, Q numbers looked at.

    Forces are per mean line mass, so in m^2/s^2, as everything of a `MotionSetup`.

    Attributes:
        recording, frame: (S,) where each is.
        velocity, acceleration: (S, n, 3) of the nodes.
        frames: (S, n, 3, 3) columns m1, m2, tangent at the nodes.
        left: (S, Q, D) what the numbers that are left see of a generalised force.
        missing: (S, Q) these numbers of the reactions.
        noise: (S, Q, Q) their covariance from the markers' noise.
        stiffness: (S, Q, D) rates of `missing` by the degrees of freedom; zero for those that
            find their equilibrium.
    """

    recording: np.ndarray
    frame: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    frames: np.ndarray
    left: np.ndarray
    missing: np.ndarray
    noise: np.ndarray
    stiffness: np.ndarray
    setup: MotionSetup
    windows: Windows
    batch: RodBatch
    strain_rate: wp.array

    def force(self, nodal: np.ndarray) -> np.ndarray:
        """(S, Q, ...) what a force (S, n, 3, ...) on the nodes adds to `missing`'s explanation."""
        return _of_nodes(self.left, nodal)

    def shift(self, moved: np.ndarray) -> np.ndarray:
        """(S, Q, ...) rates of `missing` as the markers move along (S, n, 3, ...)."""
        return _of_nodes(self.stiffness, moved)

    def rates(self, rates: list[MotionSetup]) -> np.ndarray:
        """(S, Q, P) what elastic, viscous and held-end parameters add.

        Args:
            rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate.
        """
        b, count = self.batch, len(rates)
        base = {k: np.real(v)[None] for k, v in self.setup.arrays().items()}
        model = uploaded(base, b.device) | {"rest_length": b.rest_length}
        moved = uploaded(rates_of(self.setup, rates), b.device)
        shape = (b.rod_count, count, b.node_count)
        strains = wp.zeros(shape, dtype=wp.vec4d, device=b.device)
        out = wp.zeros((b.rod_count * count, b.dof_count), dtype=wp.float64, device=b.device)
        s = b.state
        # The kernel's strain rate is a difference of strains over a step: here it is given, but for
        # that of stretching, which markers do not show.
        strain_rate = wp.array(
            self.strain_rate.numpy() * [1.0, 1.0, 1.0, 0.0], dtype=wp.vec4d, device=b.device
        )
        b.launch(
            motion_tangents.elastic_tangents,
            (b.rod_count, b.node_count - 1, 1),
            [model[k] for k in ELASTIC]
            + [moved[k] for k in ELASTIC]
            + [unit_pace(b, 0.0, 1.0, 0.0)]
            + [s.dof, s.director, s.reference_twist, strain_rate, strain_rate]
            + [strains, strains, count],
            [out],
        )
        out = out.numpy().reshape(b.rod_count, count, b.dof_count)
        explained = np.einsum("sqd,spd->sqp", self.left, out)
        ends = np.zeros((len(out), count, b.dof_count))
        for p, r in enumerate(rates):
            held = np.imag(held_ends(self.windows, r, 1)[0][:, 1]) / COMPLEX_STEP
            for k, node in enumerate((0, 1, b.node_count - 2, b.node_count - 1)):
                ends[:, p, 4 * node : 4 * node + 3] = held[:, k]
            ends[:, p, [3, -4]] = np.broadcast_to(np.imag(r.roll) / COMPLEX_STEP, 2)
        return explained - np.einsum("sqd,spd->sqp", self.stiffness, ends)


def _of_nodes(linear: np.ndarray, nodal: np.ndarray) -> np.ndarray:
    """(S, Q, ...) what maps (S, Q, D) of degrees of freedom make of (S, n, 3, ...) at the nodes."""
    flat = nodal.reshape(len(nodal), -1, *nodal.shape[3:])
    return np.einsum("sqd,sd...->sq...", linear[:, :, node_columns(nodal.shape[1])], flat)


def rates_about(
    setup: MotionSetup, model: Model, values: np.ndarray | float = 0.0
) -> list[MotionSetup]:
    """Setups whose imaginary parts are the rates of a model's parameters, by default at zero."""
    step = 1j * COMPLEX_STEP * np.eye(len(model.parameters))
    return [model.setup(setup, own) for own in values + step]


def inverse_motion(
    measurements: MotionMeasurements,
    setup: MotionSetup,
    recordings,
    spacing: int,
    *,
    device: str = "cpu",
) -> InverseMotion | None:
    """What `setup` lacks in every `spacing`-th frame of recordings.

    Frames too near to the ends of a recording, or to lost frames, to know the acceleration are left
    out, and so are those in which no equilibrium between the markers is found; None where no frame
    is left.
    """
    m = measurements
    weights = smoothing(m.rate)
    reach = weights.shape[1] // 2
    sampled = sampled_frames(m, np.asarray(recordings), spacing, reach)
    if len(sampled) == 0:
        return None
    found, settled = _settled(m, setup, sampled, weights, device)
    if not settled.any():
        return None
    if not settled.all():
        sampled = sampled[settled]
        found, _ = _settled(m, setup, sampled, weights, device)
    seen = found.result(sampled)
    if np.any(setup.viscous_time):
        # The moments of the viscous rod are linear in its viscous times.
        flowing = replace(setup, viscous_time=1j * COMPLEX_STEP * setup.viscous_time)
        seen.missing = seen.missing - seen.rates([flowing])[:, :, 0]
    return seen


def _settled(m, setup, sampled, weights, device):
    """The sampled rods at rest between their markers, and (S,) whether they came to rest."""
    path = smoothed(m, setup, sampled, weights)
    found = _Condensation(m, setup, path, _batch(setup, path, device))
    for _ in range(_ROUNDS):
        found.solve()
        found.relax()
    return found, found.solve()


def _batch(setup, path, device) -> RodBatch:
    """The rods under weight, drag and minus mass times acceleration."""
    a = {k: np.real(v) for k, v in setup.arrays().items()}
    speed = np.linalg.norm(path.velocity, axis=2, keepdims=True)
    drag = a["linear_drag"][:, None] + a["quadratic_drag"][:, None] * speed
    loads = a["mass"][:, None] * (a["gravity"] - path.acceleration) - drag * path.velocity
    _, tangent, _, director = held_ends(path.windows, setup, 1)
    path.grip_tangent, path.grip_director = np.real(tangent[:, 1]), np.real(director[:, 1])
    batch = rods_on_mesh(a, path.position, path.grip_director[:, 0], loads, device)
    places = tuple(int(i) for i in setup.marker_node)
    prescribe(batch, clamped_nodes=places, clamped_angles=(0, -1))
    state = batch.state
    dof = state.dof.numpy().copy()
    for edge, column, k in ((0, 3, 0), (-1, -4, 1)):
        t, d = (v.numpy()[:, edge] for v in (state.tangent, state.director))
        own = transport(path.grip_director[:, k], path.grip_tangent[:, k], t)
        dof[:, column] = angle_about(t, d, own)
    # The angles between begin with an even share of the twist.
    edges = batch.node_count - 1
    dof[:, 3::4] = dof[:, 3:4] + (dof[:, -4:-3] - dof[:, 3:4]) * (np.arange(edges) / (edges - 1))
    state.dof.assign(dof)
    return batch


class _Condensation:
    """The sampled rods between their markers, and what the markers feel of them."""

    def __init__(self, m, setup, path, batch):
        self.m, self.setup, self.path, self.batch = m, setup, path, batch
        n = batch.node_count
        place = setup.marker_node
        self.markers = (4 * place[:, None] + np.arange(3)).ravel()
        self.free = (4 * place[2:-2, None] + np.arange(3)).ravel()
        self.inner = np.flatnonzero(batch.free.numpy()[0])
        self.system = BandedSystem(batch, right_hand_sides=len(self.free))
        self.mass = np.real(setup.arrays()["mass"])
        self.lengths = batch.rest_length.numpy().copy()
        self.spans = np.repeat(np.arange(len(place) - 3), np.diff(place[1:-1]))
        self.tension = np.zeros((batch.rod_count, len(place) - 3))
        # Hats between the markers, of which the fields along the rod are made.
        self.hats = np.stack([np.interp(np.arange(n), place, e) for e in np.eye(len(place))], 1)

    def solve(self) -> np.ndarray:
        """Find shapes and twist between the markers, the spans' tensions as they are; (S,) whether
        they were found."""
        stretching = self.batch.stretching_stiffness.numpy()
        rest = self.lengths.copy()
        rest[:, 1:-1] /= 1.0 + self.tension[:, self.spans] / stretching[:, 1:-1]
        self.batch.rest_length.assign(rest)
        found = EquilibriumSolver(self.batch).solve(tolerance=_TOLERANCE)
        out = self.batch.evaluate(order=2)
        gradient = out.gradient.numpy()
        self.system.factorise(out.hessian, self.batch.every_rod)
        moved = np.zeros(self.system.x.shape)
        moved[:, np.arange(len(self.free)), self.free] = 1.0
        self.see = self._carried(moved)
        self.felt = self._times_hessian(self.see).numpy()
        self.felt[:, :, self.inner] = 0.0
        self.reaction = np.einsum("sfd,sd->sf", self.see, gradient)
        t = unit(np.diff(self.batch.positions(), axis=1))
        pull = np.zeros((*gradient.shape, self.tension.shape[1]))
        for e, span in enumerate(self.spans, start=1):
            pull[:, 4 * e : 4 * e + 3, span] -= t[:, e]
            pull[:, 4 * e + 4 : 4 * e + 7, span] += t[:, e]
        self.by_tension = self.see @ pull
        noise = self.m.noise
        scatter = noise * np.linalg.norm(self.path.weights[0]) * self.felt[:, :, self.markers]
        columns = node_columns(self.batch.node_count)
        inertia = np.zeros((gradient.shape[1], len(self.markers)))
        inertia[columns] = np.kron(self.mass[:, None] * self.hats, np.eye(3))
        jerk = noise * np.linalg.norm(self.path.weights[2]) * (self.see @ inertia)
        self.noise = scatter @ scatter.transpose(0, 2, 1) + jerk @ jerk.transpose(0, 2, 1)
        return found.converged

    def _times_hessian(self, vectors: np.ndarray) -> wp.array:
        """Products of the Hessian with (S, column, D) vectors."""
        b, given = self.batch, self.batch.array(vectors)
        product = wp.zeros_like(given)
        multiply_banded(b, b.every_rod, b.derivatives.hessian, given, product)
        return product

    def _carried(self, moved: np.ndarray) -> np.ndarray:
        """(S, column, D) how all moves as the markers move so, and what is between follows; the
        Hessian is factorised."""
        following = self._times_hessian(moved)
        self.system.solve_in(following, self.batch.every_rod)
        return moved - following.numpy()

    def relax(self) -> None:
        """The likeliest tensions, where a missing force of some of the weight is expected."""
        size = _EXPECTED * np.linalg.norm(self.setup.gravity) * self.mass[self.setup.marker_node]
        expected = np.repeat(size[2:-2] * np.diff(self.setup.marker_node)[2:-1], 3) ** 2
        v = self.noise + np.eye(len(expected)) * expected
        white = np.linalg.solve(v, self.by_tension)
        b = self.by_tension.transpose(0, 2, 1)
        pull = np.einsum("sfk,sf->sk", white, self.reaction)
        change = -np.linalg.solve(b @ white, pull[..., None])[..., 0]
        self.tension = self.tension + change
        self.reaction = self.reaction + np.einsum("sfk,sk->sf", self.by_tension, change)
        self.change = change

    def result(self, sampled) -> InverseMotion:
        """What is left when the tensions are free."""
        b, path = self.batch, self.path
        full = np.linalg.qr(self.by_tension, mode="complete")[0]
        left = full[:, :, self.tension.shape[1] :].transpose(0, 2, 1)
        directors = b.material_directors()
        t = np.diff(b.positions(), axis=1)
        return InverseMotion(
            recording=sampled[:, 0],
            frame=sampled[:, 1],
            velocity=path.velocity,
            acceleration=path.acceleration,
            frames=node_frames(directors[:, :, 0], t),
            left=left @ self.see,
            missing=np.einsum("sqf,sf->sq", left, self.reaction),
            noise=left @ self.noise @ left.transpose(0, 2, 1),
            stiffness=left @ self.felt,
            setup=self.setup,
            windows=path.windows,
            batch=b,
            strain_rate=self._strain_rate(),
        )

    def _strain_rate(self) -> wp.array:
        """(S, n) rates of the strains: markers by their velocities, what is between follows."""
        b = self.batch
        rate = np.zeros((b.rod_count, 1, b.dof_count))
        rate[:, 0, node_columns(b.node_count)] = self.path.velocity.reshape(b.rod_count, -1)
        rate[:, :, self.inner] = 0.0
        rate = self._carried(rate)
        out = wp.zeros((b.rod_count, 1, b.node_count), dtype=wp.vec4d, device=b.device)
        s = b.state
        b.launch(
            observed_tangents.measure_strain_tangents,
            (b.rod_count, b.node_count - 1, 1),
            [b.every_rod, s.dof, s.director] + [b.array(rate), 1],
            [out],
        )
        return out.reshape((b.rod_count, b.node_count))
