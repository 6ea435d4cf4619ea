"""A problem with known answers that rod solvers are compared on: a heavy cantilever.

At rest it is the heavy elastica (clamped level, bent by its weight, slightly stretched); without
gravity it swings at a closed-form frequency.
"""

import time
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from wrod.errors import RodError
from wrod.rods.material import RodMaterial

# First root of cos(x) cosh(x) = -1.
_ROOT = 1.875104068711961


@dataclass(frozen=True)
class Cantilever:
    """A rod of `length` [m] clamped at the origin along x; gravity acts along -z."""

    rod: RodMaterial
    length: float

    @cached_property
    def tip(self) -> np.ndarray:
        """(3,) tip of the continuous rod at rest [m]: B theta'' = w (L - s) (1 + e) cos(theta),
        stretched by e = -w (L - s) sin(theta) / EA; by collocation."""
        from scipy.integrate import solve_bvp

        scale = self.length**3 * self.rod.weight / self.rod.bending_stiffness
        softness = self.rod.weight * self.length / self.rod.stretching_stiffness

        def rhs(s, y):
            theta, bend = y[:2]
            stretch = 1.0 - softness * (1.0 - s) * np.sin(theta)
            return np.stack(
                [
                    bend,
                    scale * (1.0 - s) * stretch * np.cos(theta),
                    stretch * np.cos(theta),
                    stretch * np.sin(theta),
                ]
            )

        def ends(a, b):
            return np.array([a[0], b[1], a[2], a[3]])

        s = np.linspace(0.0, 1.0, 400)
        guess = np.stack([-1.4 * (1.0 - np.exp(-3.0 * s)), 0 * s, 0.4 * s, -0.8 * s])
        found = solve_bvp(rhs, ends, s, guess, tol=1e-9, max_nodes=10000)
        if not found.success:
            raise RodError(
                f"the cantilever hangs too steeply for its equation ({found.message}); "
                "shorten --length or lessen --scale"
            )
        x, z = self.length * found.y[2:, -1]
        return np.array([x, 0.0, z])

    @property
    def omega(self) -> float:
        """First angular frequency without gravity [rad/s]."""
        line = self.rod.weight / self.rod.gravity
        return _ROOT**2 * np.sqrt(self.rod.bending_stiffness / line) / self.length**2

    @property
    def period(self) -> float:
        return 2.0 * np.pi / self.omega

    def mode(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First mode and its slope at x [m], 1 at the tip; zero inside the clamp."""
        u = _ROOT * np.maximum(x, 0.0) / self.length
        ratio = (np.sinh(_ROOT) - np.sin(_ROOT)) / (np.cosh(_ROOT) + np.cos(_ROOT))
        value = np.cosh(u) - np.cos(u) - ratio * (np.sinh(u) - np.sin(u))
        slope = np.sinh(u) + np.sin(u) - ratio * (np.cosh(u) - np.cos(u))
        return value / 2.0, slope * _ROOT / self.length / 2.0


@dataclass(frozen=True)
class Start:
    """How a cantilever begins: straight and level.

    Attributes:
        gravity: whether its weight acts.
        damping: rate at which its motion is damped, near critical, so that it comes to rest.
        swing: amplitude of the first mode that its velocity starts [m].
        rods: how many are simulated at once.
    """

    gravity: bool = True
    damping: bool = True
    swing: float = 0.0
    rods: int = 1


class Solver(Protocol):
    """What the comparison asks of a solver; `name` and `effort` go into the table."""

    name: str
    effort: str
    dt: float
    device: str

    def advance(self, steps: int) -> None: ...

    def tips(self) -> np.ndarray:
        """(rod, 3) positions of the free ends [m]."""


def clock(solver: Solver) -> float:
    """CPU time [s], or on a GPU the time on the wall when all its work is done."""
    if solver.device == "cpu":
        return time.process_time()
    import warp as wp

    wp.synchronize_device(solver.device)
    return time.perf_counter()


@dataclass(frozen=True)
class Rest:
    """`error`: distance of the tip from the continuum's over the length; `drift`: how far the tip
    still moves, over the length and per second; `step_ms`: CPU time of a step of all rods;
    `cpu_per_second`: CPU time per simulated second and rod."""

    error: float
    drift: float
    step_ms: float
    cpu_per_second: float


def come_to_rest(solver: Solver, problem: Cantilever, duration: float, rods: int = 1) -> Rest:
    """Simulate `duration` [s] from the straight start; the second half is timed."""
    first, timed, last = (max(round(f * duration / solver.dt), 2) for f in (0.5, 0.45, 0.05))
    solver.advance(first)
    begin = clock(solver)
    solver.advance(timed)
    spent = clock(solver) - begin
    if spent <= 0.0:
        raise RodError(
            f"{timed} steps are over before this machine's clock ticks; give more --periods or "
            "--edges"
        )
    before = solver.tips()
    solver.advance(last)
    tips = solver.tips()
    away = np.linalg.norm(tips - problem.tip, axis=1).max() / problem.length
    drift = np.linalg.norm(tips - before, axis=1).max() / problem.length / (last * solver.dt)
    return Rest(
        float(away), float(drift), 1e3 * spent / timed, float(spent / (timed * solver.dt) / rods)
    )


@dataclass(frozen=True)
class Swing:
    """`frequency`: relative error of the frequency; `amplitude`: of the last swing over the first's
    (1 without damping), both None where it does not swing; `cpu_per_second`: as above."""

    frequency: float | None
    amplitude: float | None
    cpu_per_second: float


def swing(solver: Solver, problem: Cantilever, periods: float = 2.6, samples: int = 40) -> Swing:
    """Let it swing and look at the tip's zero crossings."""
    every = max(round(problem.period / samples / solver.dt), 1)
    count = int(np.ceil(periods * problem.period / (every * solver.dt)))
    heights = [solver.tips()[0, 2]]
    spent = 0.0
    for _ in range(count):
        begin = clock(solver)
        solver.advance(every)
        spent += clock(solver) - begin
        heights.append(solver.tips()[0, 2])
    z = np.array(heights)
    i = np.flatnonzero(z[1:-1] * z[2:] < 0) + 1
    crossings = (i + z[i] / (z[i] - z[i + 1])) * every * solver.dt
    cost = spent / (count * every * solver.dt)
    if len(crossings) < 3:
        return Swing(None, None, float(cost))
    found = np.pi / np.diff(crossings).mean()
    swings = [np.abs(z[a:b]).max() for a, b in pairwise(i)]
    return Swing(float(found / problem.omega - 1.0), float(swings[-1] / swings[0]), float(cost))
