"""Swings of cables that a hand at rest holds, by the model that explains how they hang.

Stiffness, clamp and bend at rest are those of the statics. A swing asks for what opposes motion: an
internal damping (Kelvin and Voigt's), strands that slip (the law `plastic`), and the bend that the
cable's last handling left. As in the task, the first two frames are given: shape and velocity
halfway between them start the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from scipy.optimize import least_squares

from wrod.errors import DataError
from wrod.identification.found_rod import FoundRod
from wrod.identification.held.equilibria import CableModel, batch_of, cable_model, marked, mesh
from wrod.identification.held.fit import YIELDING, HeldFit, yielding
from wrod.identification.held.measurements import HeldCable, HeldSwing
from wrod.rods.state import node_positions
from wrod.solvers.dynamics import Dynamics

EFFECTS = ("damping", "friction", "bend")
# Time steps in the time between two frames.
_SUBSTEPS = 2
# First guess and step of the differences: "damping" and "kept" are logarithms.
_START = {"damping": (-2.5, 0.05), "friction": (0.5, 0.05), "kept": (-1.5, 0.05), "bend": (0, 0.05)}
_BOUNDS = YIELDING | {"damping": (-9.0, 2.0)}
# A swing of a model that does not converge is as far off as this [m].
_LOST = 1.0
_EVALUATIONS = 15


@dataclass(frozen=True)
class SwingModel:
    """What opposes a cable's swing, beside what it is at rest.

    Attributes:
        cable: at rest, and how it yields.
        damping: Kelvin-Voigt time [s].
    """

    cable: CableModel
    damping: float = 0.0

    @property
    def internal_damping(self) -> float:
        """Kelvin-Voigt time of the stiffness before it yields [s]: `damping` belongs to the one
        that hanging shows."""
        return self.damping * self.cable.stiffness / self.cable.first

    def rod(
        self, cable: HeldCable, *, twist_ratio: float = 2.0 / 3.0, weighted: bool = False
    ) -> FoundRod:
        """The cable as a rod, to be saved as `model.json`, planned for and laid from the end that
        the hand held. It is straight but for its bend at rest, towards its second direction m_2,
        which was the hand's +x.

        Args:
            cable: of which length, diameter, masses and gravity are taken.
            twist_ratio: twisting stiffness over the bending stiffness that hanging shows; swings in
                a plane say nothing of it.
            weighted: whether the weight at its tip is part of it.

        Raises:
            RodError: a number is none that a rod may have.
        """
        own = self.cable
        model = cable_model(
            cable.length,
            own.first,
            cable.cable_mass / cable.length,
            twist_ratio=twist_ratio * own.stiffness / own.first,
            curvature=own.curvature,
            law=own.law,
            tip_mass=cable.tip_mass if weighted else 0.0,
            gravity=cable.gravity,
        )
        fitted = replace(model, radius=0.5 * cable.diameter, internal_damping=self.internal_damping)
        swing = {"damping": self.damping, "friction": own.friction, "kept": own.kept}
        rest = {"stiffness": own.stiffness, "curvature": own.curvature}
        assumed = ("twisting_stiffness", "stretching_stiffness")
        tilt = {"clamp_tilt": {"tilt": own.tilt}} if own.tilt else {}
        effects = {"hanging": rest, "swinging": swing, **tilt}
        return FoundRod(fitted, tuple(tilt), assumed, effects)


@dataclass(frozen=True)
class SwingFit:
    """Swings of one cable explained together.

    Attributes:
        statics: what the hanging cable told.
        names, values: of the parameters: logarithm of "damping" [s], "friction" [1/m], logarithm
            of "kept", and "bend 0" [1/m], by which the first swing's natural curvature differs from
            that of the hanging cable, and so on.
        errors: standard errors, which take the residual for noise that is independent after the
            time in which it changes sign.
        residual: per swing (T - 2, 2, 2) measured minus predicted from the third frame on [m].
    """

    statics: HeldFit
    names: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    residual: tuple[np.ndarray, ...]

    def model(self, which: int, set_of: int | None = None) -> SwingModel:
        """That of swing number `which`; `set_of`: of the statics, by default the same number."""
        return _model(self.statics, self.names, self.values, which, set_of)


def predict_swings(
    cases: Sequence[tuple[HeldSwing, SwingModel]], *, substeps: int = _SUBSTEPS, device: str = "cpu"
) -> list[np.ndarray]:
    """(T - 2, 2, 2) middle and end [m] of every case from the third frame on, given the first two;
    not a number from where no time step converged.

    Args:
        cases: a swing, of which nothing but the first two frames and the times is looked at, and a
            model each; all move at once.
        substeps: time steps in the time between two frames.

    Raises:
        DataError: fewer than three frames, or frames that are not equally far apart in time.
    """
    interval = _interval([swing for swing, _ in cases])
    position, velocity = [], []
    for swing, model in cases:
        here, moves = _first(swing, model, interval)
        position.append(here)
        velocity.append(moves)
    held = [(swing.cable, 0.0, model.cable) for swing, model in cases]
    batch = batch_of(held, position=np.array(position), device=device)
    # The hand is at rest: its mean angle is free of the markers' noise.
    angle = np.array([swing.cable.angle.mean() for swing, _ in cases])
    size = np.array([swing.cable.gravity for swing, _ in cases])[:, None]
    batch.gravity.assign(size * np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)]))
    dynamics = Dynamics(
        batch,
        scheme="bdf2",
        radius=np.array([0.5 * swing.cable.diameter for swing, _ in cases]),
        internal_damping=np.array([[[model.internal_damping]] for _, model in cases]),
        keeps_recording=device == "cpu",
    )
    dynamics.refuses_saddles = False
    dynamics.set_velocity(np.array(velocity))
    counts = np.array([len(swing.time) for swing, _ in cases])
    # Halves of an interval: the motion starts halfway between the first two frames.
    until = (counts - 1.5) * interval
    shape = (len(cases), 2 * int(counts.max()), batch.dof_count)
    frames = wp.zeros(shape, dtype=wp.float64, device=device)
    reached = dynamics.advance(
        until + 1e-9, interval / substeps, frames=frames, frame_interval=0.5 * interval
    ).time
    film = node_positions(frames.numpy().reshape(-1, batch.dof_count))
    film = marked(film).reshape(*shape[:2], 2, 2)
    out = []
    for k, count in enumerate(counts):
        places = film[k, 3 : 2 * count - 2 : 2].copy()
        places[(np.arange(len(places)) + 1.5) * interval > reached[k] + 1e-6] = np.nan
        out.append(places)
    return out


def fit_swings(
    swings: Sequence[HeldSwing],
    statics: HeldFit,
    effects: Sequence[str] = ("damping",),
    *,
    use: Sequence[int] | None = None,
    device: str = "cpu",
) -> SwingFit:
    """Find what opposes a cable's swings by least squares, every swing counting alike.

    Args:
        swings: of one cable, in the order of the statics' sets.
        statics: that cable at rest.
        effects: of `EFFECTS`; none: nothing is fitted.
        use: numbers of the swings to fit; default: all.

    Raises:
        DataError: no swing, an unknown effect, or frames as `predict_swings` says.
    """
    if not swings:
        raise DataError("no swing of a cable is given")
    unknown = [name for name in effects if name not in EFFECTS]
    if unknown:
        raise DataError(f"unknown effect {unknown[0]!r}; use {', '.join(EFFECTS)}")
    use = range(len(swings)) if use is None else use
    names: tuple[str, ...] = ()
    for name in effects:
        if name == "bend":
            names += tuple(f"bend {k}" for k in use)
        else:
            names += ("friction", "kept") if name == "friction" else (name,)
    kinds = [name.split()[0] for name in names]
    start, step = (np.array([_START[kind][k] for kind in kinds], dtype=float) for k in (0, 1))
    measured = [swing.cable.markers[2:] for swing in swings]

    def residuals(many, which):
        cases = [(swings[k], _model(statics, names, v, k)) for v in many for k in which]
        places = predict_swings(cases, device=device)
        off = [np.nan_to_num(measured[k] - p, nan=_LOST)
               for p, k in zip(places, list(which) * len(many), strict=True)]  # fmt: skip
        return [off[k : k + len(which)] for k in range(0, len(off), len(which))]

    def cost(off):
        return np.concatenate([one.ravel() / np.sqrt(one.size) for one in off])

    def rates(v):
        here, *there = (cost(off) for off in residuals([v, *(v + np.diag(step))], use))
        return np.stack([(t - here) / h for t, h in zip(there, step, strict=True)], axis=1)

    values, errors = start, np.zeros(0)
    if names:
        bounds = np.array([_BOUNDS.get(kind, (-np.inf, np.inf)) for kind in kinds]).T
        found = least_squares(
            lambda v: cost(residuals([v], use)[0]), start, jac=rates, bounds=bounds,
            x_scale=4.0 * step, max_nfev=_EVALUATIONS,
        )  # fmt: skip
        values = found.x
        noise = 2.0 * found.cost / _independent(residuals([values], use)[0])
        errors = np.sqrt(noise * np.diag(np.linalg.pinv(found.jac.T @ found.jac)))
    residual = tuple(residuals([values], range(len(swings)))[0])
    return SwingFit(statics, names, values, errors, residual)


def _model(statics, names, values, which, set_of=None) -> SwingModel:
    said = dict(zip(names, values, strict=True))
    # At rest straight down neither side's memory is known: the mean of both.
    cable = statics.model(which if set_of is None else set_of, 0.0)
    cable = replace(cable, curvature=cable.curvature + said.get(f"bend {which}", 0.0))
    damping = float(np.exp(said["damping"])) if "damping" in said else 0.0
    return SwingModel(yielding(cable, said), damping)


def _independent(residual: Sequence[np.ndarray]) -> float:
    """How many independent readings: signs change once in so many frames."""
    changes = [1.0 + (np.diff(np.sign(one), axis=0) != 0).sum(axis=0).max() for one in residual]
    return float(np.sum(changes))


def _interval(swings: Sequence[HeldSwing]) -> float:
    steps = np.concatenate([np.diff(swing.time) for swing in swings])
    if min(len(swing.time) for swing in swings) < 3:
        raise DataError("a swing has fewer than 3 frames; two are given and the rest predicted")
    if np.ptp(steps) > 0.01 * steps.mean():
        raise DataError("frames of the swings are not equally far apart in time")
    return float(steps.mean())


def _first(swing: HeldSwing, model: SwingModel, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """(node, 3) places [m] and velocities [m/s] halfway between the first two frames, the edges of
    the mesh's lengths and the first one in the clamp."""
    s = mesh(swing.cable.length)
    curves = [swing.curve(frame, s) for frame in (0, 1)]
    along = np.diff(0.5 * (curves[0] + curves[1]), axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    tilt = model.cable.tilt
    along[0] = np.sin(tilt), -np.cos(tilt)
    edges = along * np.diff(s)[:, None]
    places = s[0] * along[0] + np.vstack([np.zeros(2), np.cumsum(edges, axis=0)])
    speeds = (curves[1] - curves[0]) / interval
    speeds[:2] = 0.0
    out = np.zeros((2, len(s), 3))
    out[0][:, [0, 2]], out[1][:, [0, 2]] = places, speeds
    return out[0], out[1]
