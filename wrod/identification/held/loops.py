"""Cables hung as a loop between two exits, level and side by side, and twisted there.

The cable leaves the right exit level towards +x, hangs down and comes back to the left exit level
towards +x. One exit may be turned about the cable: the loop then leaves its plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from wrod.errors import DataError
from wrod.identification.held.equilibria import between_ends, cable_model, held_batch
from wrod.identification.held.measurements import HangingLoops
from wrod.rods.law import Linear, Softening
from wrod.rods.state import node_positions
from wrod.solvers.statics import EquilibriumSolver

_EDGES = 74
# A cable hardly stretches: EA over its weight.
_STRETCH = 3e3
_STEPS = {"stiffness": 0.02, "softening": 0.1, "right": 0.02, "left": 0.02}
# Scale of the unknowns, for the fit's steps.
_SCALES = {"stiffness": 0.3, "softening": 1.0, "right": 0.2, "left": 0.2}
# A twisted loop has left its plane where one more step moves it this far [L], or where its
# equilibrium is lost or no longer stable.
_LEAP = 0.03


@dataclass(frozen=True)
class LoopModel:
    """What a hung cable is.

    Attributes:
        stiffness: bending stiffness B [N m^2].
        softening: c [m^2] and kept share r of the moment B e (r + (1 - r) / (1 + c e^2)) that
            belongs to a curvature e; c = 0 is linear. A natural curvature that is the same all
            along changes nothing: the exits fix how far the loop turns in all.
        kept: r.
        right, left: turn of the two exits from level, upwards at the exit's outer side [rad].
        twist_ratio: twisting over bending stiffness [-].
    """

    stiffness: float
    softening: float = 0.0
    kept: float = 0.2
    right: float = 0.0
    left: float = 0.0
    twist_ratio: float = 2.0 / 3.0


@dataclass(frozen=True)
class LoopFit:
    """One cable's mountings explained together.

    Attributes:
        names: of the parameters, "stiffness" as the logarithm of B over 1 N m^2.
        values, stderr: (P,); the standard errors take a mounting for one independent datum.
        residual: (mounting, point, 2) measured minus predicted [m].
    """

    names: tuple[str, ...]
    values: np.ndarray
    stderr: np.ndarray
    residual: np.ndarray

    @property
    def model(self) -> LoopModel:
        return _model(self.names, self.values)

    @property
    def rms(self) -> float:
        """RMS distance in the plane [m]."""
        return float(np.sqrt((self.residual**2).sum(axis=-1).mean()))


class TwistedLoops:
    """Loops of one cable, all solved at once.

    Args:
        loops: the cable, whose first mounting is the starting guess.
        models: one a loop.
        exits: (loop, 2) place of the left exit from the right one [m].
    """

    def __init__(
        self,
        loops: HangingLoops,
        models: Sequence[LoopModel],
        exits: np.ndarray,
        device: str = "cpu",
    ):
        count = len(models)
        self.length, h = loops.length, loops.length / _EDGES
        self.arc_length = between_ends(loops.length, _EDGES)
        inner = np.clip(self.arc_length, 0.0, loops.length)
        place = CubicSpline(loops.arc_length, loops.shape[0])(inner)
        position = np.zeros((count, _EDGES + 2, 3))
        position[:, :, 0], position[:, :, 2] = place[:, 0], place[:, 1]
        out = 0.5 * h * np.array([[np.cos(m.right), np.sin(m.right)] for m in models])
        back = 0.5 * h * np.array([[np.cos(m.left), -np.sin(m.left)] for m in models])
        exits = np.asarray(exits, dtype=float)
        for node, at in ((0, -out), (1, out), (-2, exits - back), (-1, exits + back)):
            position[:, node, 0], position[:, node, 2] = at[:, 0], at[:, 1]
        rods = [
            cable_model(
                loops.length,
                m.stiffness,
                loops.mass_per_length,
                twist_ratio=m.twist_ratio,
                stretching=_STRETCH * loops.mass_per_length * loops.gravity * loops.length,
                law=Softening(m.softening**-0.5, m.kept) if m.softening > 0.0 else Linear(),
                gravity=loops.gravity,
            )
            for m in models
        ]
        self.batch = held_batch(rods, self.arc_length, position, both=True, device=device)
        self.solver = EquilibriumSolver(self.batch)

    def solve(self, turn: np.ndarray | float = 0.0):
        """Turn the left exit about the cable to `turn` [rad], the cable following; `Equilibria`."""
        target = self.batch.state.dof.numpy().copy()
        target[:, -4] = turn
        return self.solver.solve(prescribed=target, tolerance=1e-7, max_iterations=60)

    def nodes(self) -> np.ndarray:
        """(loop, node, 3) [m]."""
        return node_positions(self.batch.state.dof.numpy())

    def at(self, arc_length: np.ndarray) -> np.ndarray:
        """(loop, point, 3) places of the arc lengths from the right exit [m]."""
        nodes, s = self.nodes(), self.arc_length.copy()
        # The exits are the middles of the clamped edges, which are straight.
        nodes[:, 0] = 0.5 * (nodes[:, 0] + nodes[:, 1])
        nodes[:, -1] = 0.5 * (nodes[:, -1] + nodes[:, -2])
        s[0], s[-1] = 0.0, self.length
        return CubicSpline(s, nodes, axis=1)(arc_length)


def fit_loops(
    loops: HangingLoops,
    effects: Sequence[str] = ("right", "left"),
    *,
    use: np.ndarray | None = None,
    device: str = "cpu",
) -> LoopFit:
    """Fit one cable's mountings by least squares.

    Args:
        loops: the mountings.
        effects: of "softening", "right" and "left"; none: a linear cable, its exits level.
        use: (mounting,) which to fit.

    Raises:
        DataError: an unknown effect, no mounting, or no equilibrium at the first guess.
    """
    unknown = [name for name in effects if name not in _STEPS or name == "stiffness"]
    if unknown:
        raise DataError(f"unknown effect {unknown[0]!r}; use softening, right, left")
    use = np.ones(len(loops.shape), dtype=bool) if use is None else np.asarray(use, dtype=bool)
    if not use.any():
        raise DataError("no mounting of the loop is left to fit")
    names = ("stiffness", *effects)
    step = np.array([_STEPS[name] for name in names])
    weight = loops.mass_per_length * loops.gravity * loops.length**3

    def predict(many):
        # One loop a candidate and mounting, as their exits differ.
        models = [_model(names, v) for v in many for _ in loops.shape]
        exits = np.tile(loops.shape[:, -1] - loops.shape[:, 0], (len(many), 1))
        hung = TwistedLoops(loops, models, exits, device)
        found = hung.solve().converged
        places = hung.at(loops.arc_length)[..., [0, 2]]
        # Where there is no equilibrium a fit is not to go: as if all points were a length off.
        places[~found] = loops.length
        return places.reshape(len(many), *loops.shape.shape) + loops.shape[:, :1]

    def residual(values):
        return (loops.shape - predict([values])[0])[use].ravel()

    def rates(values):
        here, *there = predict([values, *(values + np.diag(step))])
        return -np.stack(
            [((t - here) / h)[use].ravel() for t, h in zip(there, step, strict=True)], axis=1
        )

    start = np.array([{"softening": -2.0}.get(name, 0.0) for name in names])
    guesses = np.log(weight / np.geomspace(30.0, 4000.0, 8))
    tried = predict([np.append(g, start[1:]) for g in guesses])
    start[0] = guesses[np.argmin([((loops.shape - t)[use] ** 2).sum() for t in tried])]
    scale = np.array([_SCALES[name] for name in names])
    if not np.isfinite(start).all() or np.abs(tried).min(axis=0).min() >= loops.length:
        raise DataError(f"the {loops.name} loop finds no equilibrium; check length and mass")
    found = least_squares(residual, start, jac=rates, x_scale=scale, max_nfev=15, xtol=1e-4)
    left = loops.shape - predict([found.x])[0]
    # The points of a mounting err together: their number does not make the fit surer.
    square = found.jac.T @ found.jac / loops.shape.shape[1]
    noise = (left[use] ** 2).sum() / (loops.shape.shape[1] * max(2 * use.sum() - len(names), 1))
    stderr = np.sqrt(np.diag(noise * np.linalg.pinv(square)))
    return LoopFit(names, found.x, stderr, left)


def critical_twist(
    loops: HangingLoops,
    models: Sequence[LoopModel],
    *,
    step: float = np.radians(10.0),
    most: float = 14.0 * np.pi,
    device: str = "cpu",
) -> tuple[np.ndarray, np.ndarray]:
    """Angle of one exit about the cable at which hung loops leave their plane at once.

    The exit is turned slowly, the loop following its equilibrium; beyond the angle that is given
    one more step moves some point of it by 3 % of the length or more, or leads nowhere.

    Args:
        loops: the cable; its exits stand where its mountings have them in the mean.
        models: one a loop.
        step: in which the angle is read [rad]; most: largest angle [rad].

    Returns:
        (loop,) angles [rad], infinite where nothing happens up to `most`; and (loop, point, 3)
        places of the loops' arc lengths just before [m].
    """
    exits = np.tile((loops.shape[:, -1] - loops.shape[:, 0]).mean(axis=0), (len(models), 1))
    hung = TwistedLoops(loops, models, exits, device)
    hung.solve()
    angle = np.full(len(models), np.inf)
    shape = hung.at(loops.arc_length)
    waiting = np.ones(len(models), dtype=bool)
    before, last = hung.nodes(), shape
    for turn in np.arange(step, most + 0.5 * step, step):
        result = hung.solve(turn)
        here = hung.nodes()
        leapt = np.linalg.norm(here - before, axis=2).max(axis=1) > _LEAP * loops.length
        gone = waiting & (leapt | ~result.converged | (result.negative_pivots > 0))
        angle[gone] = turn - 0.5 * step
        shape[gone] = last[gone]
        waiting &= ~gone
        before, last = here, hung.at(loops.arc_length)
        if not waiting.any():
            break
    shape[waiting] = last[waiting]
    return angle, shape


def _model(names, values) -> LoopModel:
    said = dict(zip(names, values, strict=True))
    return LoopModel(
        float(np.exp(said["stiffness"])),
        # Half the softening is there at a curvature of 10 /m where the unknown is 0.
        1e-2 * float(np.exp(said["softening"])) if "softening" in said else 0.0,
        LoopModel.kept,
        said.get("right", 0.0),
        said.get("left", 0.0),
    )
