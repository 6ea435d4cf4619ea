"""Grasps of continuous Kirchhoff rods that vary along them, by collocation (SciPy), not elements.

Unknown along the rod are position q, tangent t, first principal direction d_1 and moment m, and the
three components of the force n at the contact:

    q' = (1 + n.t / k_s) t,  t' = w x t,  d_1' = w x d_1,  m' = -q' x n,  n' = weight z,

where w is what the section's law makes of m. At the contact the frame, the pattern's curvature and
no twisting moment are given, at the grip no bending moment; the closure is the last condition.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from wrod.bench.continuous_rod import derivatives_of, excess_of
from wrod.bench.continuous_stability import cross
from wrod.grasps.mesh import WEIGHT
from wrod.grasps.optimal import solve_grasps
from wrod.rods.law import Linear
from wrod.rods.model import RodModel

TOLERANCE = 1e-7


@dataclass
class Section:
    """Functions of the arc length from the contact, dimensionless; pairs are (2, K), along the
    principal directions. `softening`: (c, kept share)."""

    bending: object
    twisting: object
    stretching: object
    curvature: object
    twist: object
    weight: object
    softening: tuple[float, float] | None = None

    @classmethod
    def uniform(cls, stretch_ratio, natural, poisson=0.5) -> "Section":
        """Isotropic; natural curvature to the (left, up) with the first direction up."""

        def constant(*values):
            return lambda s: np.array(values)[:, None] + 0.0 * s

        def one(value):
            return lambda s: value + 0.0 * s

        return cls(
            constant(1.0, 1.0), one(1.0 / (1.0 + poisson)), one(stretch_ratio),
            constant(natural[1], -natural[0]), one(0.0), one(WEIGHT),
        )  # fmt: skip

    @classmethod
    def of(cls, model: RodModel, contact: float, lgb: float, force: float) -> "Section":
        model = model.turned(-model.principal_angle)
        bending = force * lgb**2

        def pair(profiles, unit):
            return lambda s: np.stack([p(contact + lgb * s) for p in profiles]) / unit

        def one(profile, unit):
            return lambda s: profile(contact + lgb * s) / unit

        law = None
        if not isinstance(model.law, Linear):
            c, kept = model.law.softening
            law = (c / lgb**2, kept)
        return cls(
            pair(model.bending_stiffness, bending), one(model.twisting_stiffness, bending),
            one(model.stretching_stiffness, force), pair(model.natural_curvature, 1.0 / lgb),
            one(model.natural_twist, 1.0 / lgb),
            one(model.line_mass, force / lgb / model.gravity), law,
        )  # fmt: skip

    def mixed(self, share: float) -> "Section":
        """Part of the way from a straight uniform rod of unit stiffness."""

        def between(function, base):
            return lambda s: base + share * (function(s) - base)

        softening = self.softening and (share * self.softening[0], self.softening[1])
        return Section(
            between(self.bending, 1.0), between(self.twisting, 2.0 / 3.0), self.stretching,
            between(self.curvature, 0.0), between(self.twist, 0.0),
            between(self.weight, WEIGHT), softening,
        )  # fmt: skip


def _law(softening):
    if softening is None:
        return None
    c, kept = softening

    def law(e):
        x = 1.0 + c * e * e
        return e * (kept + (1 - kept) / x), kept + (1 - kept) * (2 - x) / (x * x)

    return law


def _moments(section: Section, excess, s):
    """(2, K) moments of (2, K) excess curvatures."""
    stiffness = section.bending(s)
    linear = stiffness * excess
    if section.softening is None:
        return linear
    c, kept = section.softening
    x = c * (linear * excess).sum(0) / stiffness.mean(0)
    return linear * (kept + (1 - kept) / (1 + x))


class ContinuumGrasp:
    """Grasp of a section's rod; what is `given` beside mechanics is ("tension", force n_x at the
    contact), ("reach", x of the grip), or instead of the pattern's curvature ("held", (position,
    tangent, direction) of the grip), which is free to turn but for its roll, and in that as well
    where the direction is None."""

    def __init__(self, section: Section, length: float, kappa: float, roll: float):
        self.section, self.length, self.kappa, self.roll = section, length, kappa, roll

    def rhs(self, section, s, y, p):
        t, d, m = y[3:6], y[6:9], y[9:12]
        e = cross(t, d)
        n = np.stack([p[0] + 0 * s, p[1] + 0 * s, p[2] + y[12]])
        # dt/ds = c_1 d_1 + c_2 d_2 is the curvature vector c_1 d_2 - c_2 d_1.
        moment = np.stack([(m * e).sum(0), -(m * d).sum(0)])
        c = excess_of(moment, section.bending(s), _law(section.softening), 1.0)
        c = c + section.curvature(s)
        turn = (m * t).sum(0) / section.twisting(s) + section.twist(s)
        w = c[0] * e - c[1] * d + turn * t
        dq = (1 + (n * t).sum(0) / section.stretching(s)) * t
        parts = [dq, cross(w, t), cross(w, d), -cross(dq, n), section.weight(s)[None]]
        return np.concatenate(parts)

    def ends(self, section, given, a, b, p):
        x, d = np.array([1.0, 0, 0]), np.array([0.0, -np.sin(self.roll), np.cos(self.roll)])
        e = np.cross(x, d)
        zero = np.zeros(1)
        bent = np.array([[self.kappa * d[1]], [self.kappa * e[1]]])
        m = _moments(section, bent - section.curvature(zero), zero)[:, 0]
        start = np.concatenate([np.zeros(3), x, d, m[0] * e - m[1] * d, zero])
        across = np.cross(b[3:6], b[6:9])
        free = [b[9:12] @ b[6:9], b[9:12] @ across]
        if given[0] == "held":
            place, t, d = given[1]
            if d is not None:
                axis = np.cross(t, b[3:6])
                carried = np.cross(axis, np.cross(axis, d)) / (1 + t @ b[3:6])
                carried += d + np.cross(axis, d)
            clamped = np.delete(a - start, slice(9, 12))
            roll = b[9:12] @ b[3:6] if d is None else across @ carried
            return np.concatenate([clamped, b[:3] - place, free, [roll]])
        held = p[0] if given[0] == "tension" else b[0]
        return np.concatenate([a - start, free, [held - given[1]]])

    def solve(self, given, share=1.0, tolerance=TOLERANCE):
        section = self.section if share == 1.0 else self.section.mixed(share)
        s, y, p = self.guess
        rhs = partial(self.rhs, section)
        found = solve_bvp(
            rhs, partial(self.ends, section, given), s, y, p=p, fun_jac=derivatives_of(rhs),
            tol=tolerance, max_nodes=60000,
        )  # fmt: skip
        assert found.success, found.message
        self.guess = found.x, found.y, found.p
        return found

    def start(self, s, shape, force):
        """Continue from a straight rod's shape and force."""
        t = np.gradient(shape, s, axis=0)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        m = np.cross(t, np.gradient(t, s, axis=0))
        d = np.empty_like(t)
        d[0] = 0.0, -np.sin(self.roll), np.cos(self.roll)
        for i in range(1, len(t)):  # carried along without twist
            axis = np.cross(t[i - 1], t[i])
            d[i] = d[i - 1] + np.cross(axis, d[i - 1])
            d[i] -= (d[i] @ t[i]) * t[i]
            d[i] /= np.linalg.norm(d[i])
        y = np.concatenate([shape.T, t.T, d.T, m.T, WEIGHT * s[None]])
        self.guess = s, y, -np.asarray(force)

    def continued(self, step=0.4, tolerance=TOLERANCE):
        """The grasp without tension of the straight uniform rod, turned into the rod's own."""
        size = np.abs(self.section.curvature(np.array([0.0, self.length]))).max()
        size += np.abs(self.section.twist(np.zeros(1))).max()
        count = int(np.ceil(size * self.length / step))
        for share in np.linspace(0.0, 1.0, count + 1)[:-1]:
            self.solve(("tension", 0.0), share, 1e-4)
        return self.solve(("tension", 0.0), tolerance=tolerance)

    def closed(self, closure, near, step=1e-3):
        """The solution of a closure, after `continued`; for the others than zero tension at the
        reach, `near` a given one, where force or friction is least along the family."""
        if closure == "zero_tension":
            return self.solve(("tension", 0.0))
        parts = slice(0, 3) if closure == "min_force" else slice(0, 2)

        def force(reach):
            return self.solve(("reach", reach)).p[parts]

        def slope(reach):
            high, low = force(reach + step), force(reach - step)
            return high @ high - low @ low

        return self.solve(("reach", brentq(slope, near - 5e-3, near + 5e-3, xtol=1e-6)))

    def force_jacobian(self, found, rolls, step=1e-3):
        """(3, 3) derivative of the force by the grip's position, the rod clamped at the contact and
        free to turn at the grip, about its tangent if it `rolls`."""
        base = found.y[:, -1]
        frame = base[3:6] / np.linalg.norm(base[3:6]), None if rolls else base[6:9]
        guess, columns = self.guess, []
        for axis in np.eye(3):
            forces = []
            for sign in (1.0, -1.0):
                self.guess = guess
                held = ("held", (base[:3] + sign * step * axis, *frame))
                forces.append(-self.solve(held).p)
            columns.append((forces[0] - forces[1]) / (2.0 * step))
        self.guess = guess
        return np.stack(columns, axis=1)

    def read(self, found):
        """(position, rotation, force) of the grip."""
        end = found.y[:, -1]
        t, d = end[3:6], end[6:9]
        t, e = t / np.linalg.norm(t), np.cross(t, d)
        z = np.cos(self.roll) * d - np.sin(self.roll) * e
        frame = np.stack([t, np.cross(z, t), z], axis=1)
        return end[:3], Rotation.from_matrix(frame), -found.p


def uniform_grasp(
    ls, kappa, ks, natural=(0.0, 0.0), poisson=0.5, *, near=0.0, closure="zero_tension",
    tolerance=TOLERANCE,
):  # fmt: skip
    """Of a uniform isotropic rod: (`ContinuumGrasp`, solution); `near` as in `closed`."""
    rod = ContinuumGrasp(Section.uniform(ks, natural, poisson), ls, kappa, 0.0)
    straight = solve_grasps(ls, kappa, ks)
    rod.start(straight.arc_length[0], straight.shape[0], straight.force[0])
    found = rod.continued(tolerance=tolerance)
    return rod, found if closure == "zero_tension" else rod.closed(closure, near)
