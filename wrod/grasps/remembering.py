"""Grasps of a rod that remembers how it was bent, while it is laid from its beginning.

What it remembers at a contact is what it went through at the contacts before: laying is slow. Some
contacts at a time are solved at once, as linear rods that have the moments, and the stiffness,
which the sweep before found; then every material point goes through its curvatures once more. Where
sweeps no longer change the grips, moments are those of the law, and the next contacts begin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp
from scipy.interpolate import Akima1DInterpolator

from wrod.errors import GraspError
from wrod.grasps.general import Ends, RodArrays, solve_general
from wrod.grasps.inputs import GraspOptions
from wrod.kernels.elastic.inelastic import Inelastic
from wrod.kernels.grasping.memory import follow_flow
from wrod.rods.law import BendingLaw

# Contacts are at most so far from each other [L_gb]: what happens to a point in between is a
# straight way.
_CLOSE = 0.1
# Grips that move less from sweep to sweep [L_gb] are found. Once moves do not shrink to such a
# share, sweeps go half of the way. A node at its yield limit may yield in one and not in the next,
# by which grasps of least force and friction go to and fro: after so many sweeps a larger move is
# small enough where it does not shrink. Most sweeps.
_SAME, _SHRINKS, _LATE, _LATELY, _SWEEPS = 1e-5, 0.8, 16, 2e-3, 60
# Least stiffness of a linear rod that stands for one that yields, over that of the rod.
_LEAST = 0.1
# Contacts that are solved at once: of more, sweeps would go to and fro.
_AT_ONCE = 16
# What of a rod the law changes.
_OF_LAW = ("bending_stiffness", "natural_curvature")


def in_order(contact: np.ndarray, lgb: float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the contacts (n,) [m] and so many evenly between them that none is far from the one
    before, and (n,) which of them were given.

    Raises:
        GraspError: they do not increase.
    """
    if not (np.diff(contact) > 0.0).all():
        raise GraspError(
            "the rod remembers how it was bent, so that its grasps depend on those before them; "
            "give contacts in the order in which they are laid, each further along the rod"
        )
    counts = np.maximum(np.ceil(np.diff(contact) / (_CLOSE * lgb) - 1e-9).astype(int), 1)
    given = np.concatenate([[0], np.cumsum(counts)])
    return np.interp(np.arange(given[-1] + 1), given, contact), given


def solve_in_order(
    history: History,
    inputs: tuple[np.ndarray, np.ndarray, np.ndarray],
    roll: np.ndarray,
    options: GraspOptions,
) -> dict[str, np.ndarray]:
    """Fields of `Grasps` at all contacts of a history. What is not solved, or goes on changing from
    sweep to sweep, has not converged.

    Args:
        inputs, roll, options: see `general.solve_general`.
    """
    coarse, fine = options.edge_count // 2, options.edge_count
    sweep = replace(options, eigenvalues=False, shapes=False, curvatures=True)
    ends: list[Ends] = []
    for first in range(0, len(roll), _AT_ONCE):
        rows, start = slice(first, first + _AT_ONCE), None
        history.go_on(rows)
        for _ in range(_SWEEPS):
            length, curvature, ratio = (value[rows] for value in inputs)
            rods = history.rods_of(rows)
            found = solve_general(length, curvature, ratio, rods, roll[rows], sweep, start)
            start = found["coarse_end"], found["fine_end"]
            for end in start:
                end[~found["converged"]] = np.nan
            bent = {coarse: found["coarse"], fine: found["fine"]}
            known = history.follow(found["position"], found["converged"], bent)
            if known:
                break
        ends.append(start)
        if not known:
            break  # what comes after would remember what is not known
    begun = [np.concatenate(of_mesh) for of_mesh in zip(*ends, strict=True)]
    missing = (0, len(roll) - len(begun[0])), (0, 0)
    start = tuple(np.pad(end, missing, constant_values=np.nan) for end in begun)
    found = solve_general(*inputs, history.rods_of(slice(None)), roll, options, start)
    found["converged"] = found["converged"] & history.settled
    return found


class History:
    """What the rod went through from its first contact on, dimensionless.

    Args:
        law: of bending, lengths in L_gb.
        contact: (n,) arc length of the contacts, increasing.
        length: (n,) suspended there.
        meshes: of the rods from contact to grip, by their numbers of edges; `general.RodArrays`.
    """

    def __init__(
        self, law: BendingLaw, contact: np.ndarray, length: np.ndarray, meshes: dict[int, RodArrays]
    ):
        self.law, self.contact, self.meshes = law.inelastic, contact, meshes
        end = contact[-1] + length[-1]
        beyond = max(int(np.ceil(length[-1] / _CLOSE)), 2)
        # Points that are all met by contacts at the same distances.
        self._point = np.concatenate([contact, np.linspace(contact[-1], end, beyond + 1)[1:]])
        # Linear rods that have the moments found last.
        self._rods = {
            edges: rods | {name: rods[name].copy() for name in _OF_LAW}
            for edges, rods in meshes.items()
        }
        # Excess and z (2, point, 2) by mesh: at the contact before the present ones, and at theirs.
        start = np.zeros((2, len(self._point), 2))
        self._before = dict.fromkeys(meshes, start)
        self._here = dict.fromkeys(meshes, start)
        self._bent: dict[int, np.ndarray] = {}
        self._rows = slice(0, 0)
        self.settled = np.zeros(len(contact), dtype=bool)

    def rods_of(self, rows: slice) -> Callable[[int], RodArrays]:
        """Linear rods of some contacts that have the moments found last, by the mesh's edges."""
        return lambda edges: {name: value[rows] for name, value in self._rods[edges].items()}

    def go_on(self, rows: slice) -> None:
        """Take the next contacts, which begin with the excess of the last one before them."""
        self._rows, self._before = rows, dict(self._here)
        self._grip: np.ndarray | None = None
        self._sweeps, self._moved, self._halved = 0, np.inf, False
        for edges, bent in self._bent.items():
            natural = self.meshes[edges]["natural_curvature"]
            excess = bent[-1] - natural[rows.start - 1]
            self._bent[edges] = excess + natural[rows]
            self._gone_through(edges, self._bent[edges])

    def follow(self, grip: np.ndarray, solved: np.ndarray, bent: dict[int, np.ndarray]) -> bool:
        """Go once more through the curvatures (n, node, 2) at the nodes of each mesh, where the
        grips are at (n, 3), those of `solved` grasps; whether nothing changes any more."""
        if self._grip is not None:
            moved = np.where(solved, np.linalg.norm(grip - self._grip, axis=1), 0.0)
            moved = np.maximum.accumulate(np.nan_to_num(moved, nan=np.inf))
            stays = bool(moved[-1] > _SHRINKS * self._moved)
            self._halved |= stays
            settled = moved < (_LATELY if stays and self._sweeps > _LATE else _SAME)
            self.settled[self._rows] = settled
            self._moved = moved[-1]
        self._grip = grip
        if self.settled[self._rows].all():
            return True
        # Where there is no grasp, the rod hangs as it did before.
        last = np.maximum.accumulate(np.where(solved, np.arange(len(solved)), 0))
        self._sweeps += 1
        for edges, curvature in bent.items():
            found = curvature[last]
            if edges in self._bent:  # what these contacts began with
                never = ~np.logical_or.accumulate(solved)
                found[never] = self._bent[edges][never]
            if self._halved:
                found = 0.5 * (found + self._bent[edges])
            self._bent[edges] = found
            self._gone_through(edges, found)
        return False

    def _gone_through(self, edges: int, bent: np.ndarray) -> None:
        rows = self._rows
        rods = {name: value[rows] for name, value in self.meshes[edges].items()}
        natural, stiffness = rods["natural_curvature"], rods["bending_stiffness"]
        excess = np.nan_to_num(bent - natural)
        excess[:, -1] = 0.0
        start = np.zeros_like(rods["rest_length"][:, :1])
        node = self.contact[rows, None] + np.cumsum(
            np.concatenate([start, rods["rest_length"]], axis=1), axis=1
        )
        before = self._at_contact_before(edges, node, excess, stiffness)
        count = excess[..., 0].size
        lagging, tangent = self._flow(
            excess.reshape(1, count, 2), stiffness.reshape(count, 2), before.reshape(2, count, 2)
        )
        lagging, tangent = (value.reshape(excess.shape) for value in (lagging, tangent))
        share = self.law[1]
        # The linear rod with this moment here, as stiff as the law goes on.
        softer = np.maximum(1.0 - share * (1.0 - tangent), _LEAST)
        moment = excess - share * (excess - lagging)
        self._rods[edges]["bending_stiffness"][rows] = stiffness * softer
        self._rods[edges]["natural_curvature"][rows] = natural + excess - moment / softer

    def _at_contact_before(
        self, edges: int, node: np.ndarray, excess: np.ndarray, stiffness: np.ndarray
    ) -> np.ndarray:
        """(2, n, node, 2) excess and z of nodes at the contact before theirs, 0 at the first."""
        points, first = self._point, self._rows.start
        at = np.broadcast_to(points, (len(node), len(points)))
        # Every contact is a point: the first that hangs there, and the first of the one before.
        contact = first + np.arange(len(node))
        hangs = np.arange(len(points)) >= contact[:, None]
        path = np.where(hangs[..., None], _akima(node, excess, at), 0.0)
        of_points = np.stack([np.interp(points, node[0], stiffness[0, :, k]) for k in (0, 1)], 1)
        lagging, _ = self._flow(path, of_points, self._before[edges])
        went = np.stack([path, lagging], axis=1)
        self._here[edges] = went[-1]
        both = np.concatenate([self._before[edges][None], went[:-1]])
        both = np.concatenate([both[:, 0], both[:, 1]], axis=2)
        before = _akima(at, both, node, np.maximum(contact - 1, 0))
        before[contact == 0] = 0.0
        return np.stack(np.split(before, 2, axis=2))

    def _flow(
        self, excess: np.ndarray, stiffness: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """z and its derivatives (step, point, 2) along excess curvatures, from excess and z."""
        steps, count, _ = excess.shape
        number, share, scale, time = self.law
        node = np.zeros(count, dtype=Inelastic.numpy_dtype())
        node["law"], node["share"], node["scale"], node["time"] = number, share, scale, time
        node["span"] = np.inf
        node["excess"], node["lagging"] = start
        weight = stiffness / stiffness.mean(axis=1, keepdims=True)
        arrays = [wp.array(value, dtype=wp.vec2d, device="cpu") for value in (excess, weight)]
        out = [wp.empty((steps, count), dtype=wp.vec2d, device="cpu") for _ in range(2)]
        state = wp.array(node, dtype=Inelastic, device="cpu")
        wp.launch(follow_flow, count, [*arrays, state], out, device="cpu")
        return out[0].numpy(), out[1].numpy()


def _akima(
    at: np.ndarray, value: np.ndarray, wanted: np.ndarray, first: np.ndarray | int = 0
) -> np.ndarray:
    """Values (row, wanted, k) at places between increasing ones (row, place) from each row's
    `first` on, without overshooting at kinks; beyond them those at their ends.

    To SciPy all rows are one curve, one after the other, between them two places on each side
    whose slopes are what Akima takes beyond an end. Nothing further away counts.
    """
    row, first = np.arange(len(at)), np.broadcast_to(first, len(at))
    beyond = np.array([1.0, 2.0])
    ends = at[:, :1] - np.diff(at[:, :2]) * beyond[::-1], at[:, -1:] + np.diff(at[:, -2:]) * beyond
    x = np.concatenate([ends[0], at, ends[1]], axis=1)
    v = np.pad(value, ((0, 0), (2, 2), (0, 0)), mode="edge")

    def slope(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return (v[row, j] - v[row, i]) / (x[row, j] - x[row, i])[:, None]

    for end, out in ((first + 2, -1), (np.full(len(at), at.shape[1] + 1), 1)):
        last, last_but_one = slope(end - out, end), slope(end - 2 * out, end - out)
        for place in (end + out, end + 2 * out):
            last, last_but_one = 2.0 * last - last_but_one, last
            step = x[row, place] - x[row, place - out]
            v[row, place] = v[row, place - out] + last * step[:, None]
    apart = (row * (np.ptp(x) + 1.0))[:, None]
    curve = Akima1DInterpolator((x + apart).ravel(), v.reshape(-1, v.shape[2]))
    return curve(np.clip(wanted, at[row, first][:, None], at[:, -1:]) + apart)
