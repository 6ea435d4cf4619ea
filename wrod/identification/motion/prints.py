"""Ways for the force that a motion's model lacks to come about, and how well each does.

A print is a profile along the rod, or a few numbers at its ends, that stays the same for all time;
what it multiplies is measured, and the reactions at the markers are linear in it. The base model's
drag may move along with each. Its stiffness stays: were mass (or a force against the weight) and
stiffness free at once, a rod without either would lack nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from wrod.identification.clamped.trace import KNOTS, Print, ProbedProfile, hats, infer, smooth_prior
from wrod.identification.effect import Effect, Model, Parameter, effects
from wrod.identification.motion.inverse import InverseMotion, rates_about

_BLOCKS = 4
_LEAST_STEP, _MOST_STEPS = 0.03, 4
# Rounds in which what no print takes away, and so the weight of every number, settles.
_ROUNDS = 3
# Exchanges of bounds at most, many times what there are.
_EXCHANGES = 1000
_WITHOUT_STIFFNESS = {"force_with_acceleration", "force_in_laboratory"}


class _Curvature(Effect):
    """A moment fixed in the material: a curvature dt/ds at rest along m1 and m2.

    Args:
        hats: (n, K) of its stations.
    """

    reference = ""

    def __init__(self, hats: np.ndarray):
        self.hats = hats
        self.parameters = (Parameter("curvature", "1/m", 1.0),) * (2 * hats.shape[1])

    def apply(self, setup, values):
        own = self.hats @ np.reshape(values, (-1, 2))
        setup.natural_curvature = setup.natural_curvature + own


@dataclass
class _Hypothesis:
    """A print to be.

    Attributes:
        scale: how large its parameters may well be; bounds: what is plausible at all.
        columns: (S, Q, P) what they add to what `InverseMotion.missing` explains.
        place: (K,) stations of a profile [m]; None for numbers at the ends.
        smooth: whether neighbouring stations are alike.
    """

    name: str
    title: str
    unit: str
    points_to: tuple[str, ...]
    components: tuple[str, ...]
    scale: float
    bounds: tuple[float, float]
    columns: np.ndarray
    place: np.ndarray | None
    smooth: bool = True
    precision: np.ndarray | None = None

    def prior(self) -> np.ndarray:
        """(P, P) covariance of the parameters over their scale."""
        if self.place is None or not self.smooth:
            return np.eye(self.columns.shape[2])
        return smooth_prior(len(self.components))

    def may_join(self, others: list[_Hypothesis]) -> bool:
        """Whether it and others cannot take everything away by taking the rod away."""
        names = {self.name, *(o.name for o in others)}
        return "moment_with_curvature" not in names or not names & _WITHOUT_STIFFNESS


def find_prints(
    seen: InverseMotion, arc_length: np.ndarray, weigh: Callable
) -> tuple[tuple[Print, ...], tuple[tuple[tuple[str, ...], float], ...], dict[str, float]]:
    """Prints, the most telling first, the steps in which they go together, and the share that each
    takes of what the first step leaves.

    Args:
        seen: the sampled frames.
        arc_length: (K,) of the markers from grip to grip [m].
        weigh: called with what no print takes away (S, Q); returns a function that makes columns
            (S, Q, ...) of unit variance, and what noise leaves of every frame's squares (S,).
    """
    drag = seen.force(-seen.setup.node_length[:, None] * seen.velocity)[..., None]
    hypotheses = _hypotheses(seen, arc_length)
    without = {*_WITHOUT_STIFFNESS, "moment_with_curvature"}
    together = [h for h in hypotheses if h.name not in without]
    x = np.concatenate([drag, *(h.columns * h.scale for h in together)], axis=2)
    penalty = block_diag(np.zeros((1, 1)), *(np.linalg.inv(h.prior()) for h in together))
    left = seen.missing
    for _ in range(_ROUNDS):
        whiten, floor = weigh(left)
        flat, y = whiten(x).reshape(-1, x.shape[2]), whiten(seen.missing).ravel()
        left = seen.missing - x @ np.linalg.solve(flat.T @ flat + penalty, flat.T @ y)
    whiten, floor = weigh(left)
    regression = _Regression(
        whiten(drag), -np.real(seen.setup.linear_drag.max()), whiten(seen.missing), floor,
        seen.recording,
    )  # fmt: skip
    prints = []
    for h in hypotheses:
        h.columns = whiten(h.columns) * h.scale
        h.precision = regression.precision(h.columns, h.prior())
        value, stderr = regression.estimate(h)
        shape = -1 if h.place is None else (len(h.place), len(h.components))
        value, stderr = (np.reshape(h.scale * a, shape) for a in (value, stderr))
        prints.append(
            Print(
                h.name, h.title, h.unit, h.points_to, None, regression.share([h]), h.place,
                h.components, value, stderr,
            )
        )  # fmt: skip
    chosen, steps = [], []
    while len(chosen) < _MOST_STEPS:
        left = [h for h in hypotheses if h not in chosen and h.may_join(chosen)]
        shares = [regression.share([*chosen, h]) for h in left]
        best = int(np.argmax(shares))
        if shares[best] < (steps[-1][1] if steps else 0.0) + _LEAST_STEP:
            break
        chosen.append(left[best])
        steps.append((tuple(h.name for h in chosen), shares[best]))
    remaining = {}
    if steps:
        (_, share), first = steps[0], chosen[0]
        for h in hypotheses:
            if h is not first and h.may_join([first]):
                more = regression.share([first, h]) - share
                remaining[h.name] = more / max(1.0 - share, 1e-12)
    return tuple(sorted(prints, key=lambda p: -p.share)), tuple(steps), remaining


def _hypotheses(seen: InverseMotion, arc_length: np.ndarray) -> list[_Hypothesis]:
    setup, known = seen.setup, effects("motion")
    even = np.linspace(0.0, arc_length[-1], KNOTS)
    mass = setup.node_length[:, None] * hats(setup.fraction)
    frames, pull = seen.frames, setup.gravity - seen.acceleration
    weight = np.linalg.norm(setup.gravity)
    lab = np.broadcast_to(weight * np.eye(3), frames.shape)
    speed = np.linalg.norm(seen.velocity, axis=2, keepdims=True)
    against = -seen.velocity[..., None]
    own, axes = ("m1", "m2", "tangent"), ("x", "y", "z")
    # A mass may hang at one place, so that its profile is as fine as the markers and not smooth.
    place = setup.marker_node[1:-1]
    fine = np.stack([np.interp(np.arange(len(mass)), place, e) for e in np.eye(len(place))], 1)
    shifted = -np.einsum("nk,snic->snikc", fine, frames[..., :2]).reshape(*pull.shape, -1)
    masses = np.einsum("n,nk,sni->snik", setup.node_length, fine[:, 1:-1], pull)

    def along(vectors):
        """Columns of a force per mass (S, n, 3, components) times each knot's hat."""
        return seen.force(np.einsum("nk,snic->snikc", mass, vectors).reshape(*pull.shape, -1))

    def of(*chosen):
        return seen.rates(rates_about(setup, Model(chosen)))

    return [
        _Hypothesis(
            "force_in_laboratory", "force over the weight, fixed in the laboratory", "",
            ("gravity_tilt",), axes, 0.1, (-1.0, 1.0), along(lab), even,
        ),
        _Hypothesis(
            "force_in_material", "force over the weight that turns with the material", "",
            (), own, 0.1, (-1.0, 1.0), along(weight * frames), even,
        ),
        _Hypothesis(
            "force_with_acceleration", "force that follows gravity less acceleration, as a "
            "relative change of mass", "", ("mass_gradient", "point_mass"), ("mass",), 0.1,
            (-0.5, 10.0), seen.force(masses), arc_length[1:-1], smooth=False,
        ),
        _Hypothesis(
            "force_with_velocity", "force against the velocity", "1/s", ("air_damping",),
            ("drag",), 1.0, (0.0, 10.0), along(against), even,
        ),
        _Hypothesis(
            "force_with_speed_squared", "force against the velocity that grows with its square",
            "1/m", ("quadratic_drag",), ("drag",), 1.0, (0.0, 10.0),
            along(speed[..., None] * against), even,
        ),
        _Hypothesis(
            "moment_with_strain_rate", "moment that follows the rate of bending, as a viscous time",
            "s", ("internal_damping", "relaxation"), ("viscous time",), 0.03,
            (-np.max(setup.viscous_time), 1.0), of(ProbedProfile("viscous_time", 0.03)), even,
        ),
        _Hypothesis(
            "moment_in_material", "moment that turns with the material, as a curvature at rest",
            "1/m", ("natural_curvature", "natural_curvature_profile"), own[:2], 1.0,
            (-50.0, 50.0), of(_Curvature(fine)), arc_length, smooth=False,
        ),
        _Hypothesis(
            "twist_in_material", "twisting moment that turns with the material, as a twist at rest",
            "rad/m", ("natural_twist", "grip_roll"), ("twist",), 3.0,
            (-20.0, 20.0), of(ProbedProfile("natural_twist", 3.0)), even,
        ),
        _Hypothesis(
            "moment_with_curvature", "moment that follows the curvature, as a relative change of "
            "stiffness", "", ("stiffness", "stiffness_profile", "anisotropic_bending",
            "clamp_length"), ("stiffness",), 0.1, (-0.5, 1.0),
            of(ProbedProfile("bending", 0.1, relative=True)), even,
        ),
        _Hypothesis(
            "grips", "rod turned in the grips", "rad", ("grip_direction", "grip_roll"),
            ("turn first 1", "turn first 2", "turn last 1", "turn last 2", "roll"), 0.1,
            (-0.5, 0.5), of(known["grip_direction"], known["grip_roll"]), None,
        ),
        _Hypothesis(
            "markers", "markers beside the centreline", "m", ("marker_offset",), own[:2],
            3e-3, (-8e-3, 8e-3), seen.shift(shifted), arc_length, smooth=False,
        ),
    ]  # fmt: skip


class _Regression:
    """Linear models of what is missing within bounds, with the drag free beside them.

    Args:
        drag: (S, Q, 1) its column, and the least that it may be [1/s].
        y: (S, Q) what is missing; floor: (S,) what noise leaves of its squares; all whitened.
        recording: (S,) of each frame.
    """

    def __init__(self, drag, least_drag, y, floor, recording):
        self.drag, self.least, self.y, self.floor = drag, least_drag, y, floor.sum()
        self.recordings, self.of = np.unique(recording, return_inverse=True)
        count = len(self.recordings)
        self.block = np.arange(count) * min(_BLOCKS, count) // count
        self.square = np.bincount(self.of, np.sum(y**2, axis=1))
        self.before = self._left_out([])

    def precision(self, columns, prior) -> np.ndarray:
        """(P, P) inverse of the parameters' prior covariance, of the likeliest size."""
        flat, free = columns.reshape(self.y.size, -1), self.drag.reshape(self.y.size, -1)
        q = np.linalg.qr(free)[0]
        y = self.y.ravel()
        size = infer(flat - q @ (q.T @ flat), y - q @ (q.T @ y), prior)[1]
        return np.linalg.inv(prior) / max(size, 1e-12)

    def share(self, chosen: list[_Hypothesis]) -> float:
        """Share of the missing squares above the noise that they take away in what is left out."""
        after = self._left_out(chosen)
        return float((self.before - after) / max(self.before - self.floor, 1e-300))

    def estimate(self, h: _Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """(P,) values and standard errors, from leaving out one recording after the other."""
        solve, every = self._solver([h]), np.ones(len(self.recordings), dtype=bool)
        value = solve(every)[1:]
        out = np.stack([solve(every & (self.recordings != r))[1:] for r in self.recordings])
        scatter = np.sum((out - out.mean(axis=0)) ** 2, axis=0)
        return value, np.sqrt((len(out) - 1) / len(out) * scatter)

    def _sums(self, chosen):
        """(R, P, P), (R, P) normal equations of every recording."""
        x = np.concatenate([self.drag, *(h.columns for h in chosen)], axis=2)
        first = np.searchsorted(self.of, np.arange(len(self.recordings)))
        h, g = x.transpose(0, 2, 1) @ x, np.einsum("sqp,sq->sp", x, self.y)
        return np.add.reduceat(h, first), np.add.reduceat(g, first)

    def _solver(self, chosen):
        """Values out of the recordings that a mask says."""
        h, g = self._sums(chosen)
        penalty = block_diag(np.zeros((1, 1)), *(c.precision for c in chosen))
        widths = [c.columns.shape[2] for c in chosen]
        lower = np.r_[self.least, np.repeat([c.bounds[0] / c.scale for c in chosen], widths)]
        upper = np.r_[np.inf, np.repeat([c.bounds[1] / c.scale for c in chosen], widths)]

        def solve(mask):
            a = h[mask].sum(axis=0) + penalty
            root = np.linalg.cholesky(a + 1e-12 * np.trace(a) / len(a) * np.eye(len(a)))
            target = np.linalg.solve(root, g[mask].sum(axis=0))
            bounds = lower, upper
            return lsq_linear(root.T, target, bounds, method="bvls", max_iter=_EXCHANGES).x

        return solve

    def _left_out(self, chosen) -> float:
        """Sum of squares that is left in blocks of recordings, fitted to the others."""
        h, g = self._sums(chosen)
        solve, total = self._solver(chosen), 0.0
        for b in np.unique(self.block):
            out = self.block == b
            v = solve(~out if (~out).any() else out)
            total += self.square[out].sum() - 2 * v @ g[out].sum(axis=0)
            total += v @ h[out].sum(axis=0) @ v
        return float(total)
