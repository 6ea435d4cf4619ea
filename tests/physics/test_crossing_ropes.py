"""Two ropes that cross without friction, the upper hung over the lower, as splines.

Ropes of 1 m between pins 0.8 m apart, those of the upper one 0.1 m lower: cosseratbench's
"crossing". Clamped cubic B-splines, whose bending, stretching and weight are
integrated by Gauss points and whose contact is at the true nearest points; derivatives by torch.
"""

import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline
from scipy.optimize import brentq

RADIUS, LENGTH, HALF_SPAN, DROP = 0.005, 1.0, 0.4, 0.1
AREA = np.pi * RADIUS**2
WEIGHT, STRETCHING, BENDING = 1000.0 * 9.81 * AREA, 1e6 * AREA, 1e6 * AREA * RADIUS**2 / 4
CONTACT = 1e4  # [N/m], of the splines: they sink in by 0.03 mm


def half(height, count):
    """(along, height) of a rope of half the length that hangs from 0, 0 to the middle."""

    def span(c):  # of a chain with c = tension / weight that ends `height` lower
        s0 = height / 2 * np.sqrt(1 + 4 * c**2 / (0.25 - height**2)) + 0.25
        return c * (np.arcsinh(s0 / c) - np.arcsinh((s0 - 0.5) / c)), s0

    c = brentq(lambda c: span(c)[0] - HALF_SPAN, 1e-3, 10.0)
    s = span(c)[1] - np.linspace(0.0, 0.5, count)
    top = span(c)[1]
    along = c * (np.arcsinh(top / c) - np.arcsinh(s / c))
    return along, np.hypot(c, s) - np.hypot(c, top)


def ropes(count):
    """(rope, count, 3), upper rope last, a little above each other."""
    out = []
    for axis, height, pin in ((0, 0.288, 0.0), (1, 0.175, -DROP)):
        along, up = half(height, count // 2 + 1)
        q = np.zeros((count, 3))
        q[: count // 2 + 1, axis], q[: count // 2 + 1, 2] = along - HALF_SPAN, up + pin
        q[count // 2 :] = q[count // 2 :: -1] * [1, 1, 1]
        q[count // 2 :, axis] *= -1
        out.append(q)
    return np.array(out)


class Splines:
    """Both ropes as splines of some segments."""

    def __init__(self, segments):
        self.knots = np.concatenate([[0] * 3, np.linspace(0, 1, segments + 1), [1] * 3])
        self.count = segments + 3
        x, w = np.polynomial.legendre.leggauss(4)
        at = (np.arange(segments)[:, None] + 0.5 * (x + 1)).ravel() / segments
        self.weight = torch.tensor(np.tile(0.5 * w / segments, segments))
        self.basis = [torch.tensor(self.rows(at, k)) for k in range(3)]
        self.near = np.array([0.5, 0.5])
        fit = self.rows(np.linspace(0, 1, 201), 0)
        points = ropes(201)
        self.control = np.array([np.linalg.lstsq(fit, q, rcond=None)[0] for q in points])
        self.control[:, [0, -1]] = points[:, [0, -1]]

    def rows(self, at, order):
        spline = BSpline(self.knots, np.eye(self.count), 3)
        return spline.derivative(order)(at) if order else spline(at)

    def energy(self, free):
        """Of the inner control points (flat)."""
        ends = torch.tensor(self.control)
        inner = free.reshape(2, self.count - 2, 3)
        control = torch.cat([ends[:, :1], inner, ends[:, -1:]], dim=1)
        r, d, dd = (torch.einsum("sc,kcx->ksx", b, control) for b in self.basis)
        stretch = d.norm(dim=2)
        turn = dd / stretch[..., None] - d * ((d * dd).sum(2) / stretch**3)[..., None]
        density = 0.5 * STRETCHING * (stretch - 1) ** 2 + 0.5 * BENDING * (turn**2).sum(2)
        whole = (self.weight * (density + WEIGHT * r[:, :, 2])).sum()
        depth = torch.clamp(2 * RADIUS - self.distance(control), min=0.0)
        return whole + 0.5 * CONTACT * depth**2

    def distance(self, control):
        """Of the nearest points, exact to second order in the control points."""
        for _ in range(30):
            g, q, h = self.nearest_terms(control.detach())
            change = torch.linalg.solve(h, -q).numpy()
            self.near = np.clip(self.near + change, 0.2, 0.8)
            if np.abs(change).max() < 1e-13:
                break
        g, q, h = self.nearest_terms(control)
        return torch.sqrt(g @ g - q @ torch.linalg.solve(h, q))

    def nearest_terms(self, control):
        at = [torch.tensor(self.rows(self.near, k)) for k in range(3)]
        (a, b), (da, db), (dda, ddb) = ((m[0] @ control[0], m[1] @ control[1]) for m in at)
        g = a - b
        h = torch.stack([da @ da + g @ dda, -(da @ db), -(da @ db), db @ db - g @ ddb])
        return g, torch.stack([g @ da, -(g @ db)]), h.reshape(2, 2)

    def matrix(self, free):
        return torch.autograd.functional.hessian(self.energy, torch.tensor(free)).numpy()

    def force(self, free):
        v = torch.tensor(free, requires_grad=True)
        return torch.autograd.grad(self.energy(v), v)[0].numpy()

    def stationary(self):
        """By Newton's method, which does not ask whether it is a minimum."""
        free = self.control[:, 1:-1].ravel().copy()
        for _ in range(60):
            force, matrix = self.force(free), self.matrix(free)
            values, modes = np.linalg.eigh(matrix)
            if np.abs(force).max() < 1e-9:
                break
            # Away from balance downhill, and in it as Newton would.
            sizes = values if np.abs(force).max() < 1e-5 else np.abs(values) + 1e-3
            change = modes @ ((modes.T @ -force) / sizes)
            free += change * min(1.0, 0.02 / np.abs(change).max())
        return free, np.abs(force).max(), values, modes


@pytest.mark.slow
def test_the_symmetric_state_is_no_minimum():
    """Ropes that keep still where cosseratbench's reference has them are held by something."""
    ropes_ = Splines(24)
    free, residual, values, modes = ropes_.stationary()
    place = ropes_.rows(ropes_.near, 0) @ np.concatenate(
        [ropes_.control[0, :1], free.reshape(2, -1, 3)[0], ropes_.control[0, -1:]]
    )
    assert residual < 1e-9
    assert place[0] == pytest.approx([0.0, 0.0, -0.2876], abs=1e-3)
    assert values[0] < -1e-3 and values[1] > 0.0
    away = [ropes_.energy(torch.tensor(free + s * 3e-4 * modes[:, 0])).item() for s in (-1, 1)]
    assert max(away) < ropes_.energy(torch.tensor(free)).item()
