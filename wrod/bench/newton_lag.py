"""Scenes of `wrod bench newton --bodies`: loads of the step before, on what another solver moves.

A slider of mass M on a spring k, moved by SolverFeatherstone, holds a taut cable of mass m. With
what the cable did at the end of the last step, Featherstone's steps of length h are

    M (x_(n+1) - 2 x_n + x_(n-1)) / h^2 = -k x_n - m a_n,

a_n the acceleration that the cable's scheme sees: in phase with the left side where it is of
second order (bdf2), a step late with euler, which damps by m / (M + m) w^2 h / 2. What goes to and
fro from step to step, x_n = (-1)^n, has a_n = 16 x_n / h^2 with bdf2 and 4 x_n / h^2 with euler,
and dies out where M > 4 m and M > m, however short the step. Loads that go by a share r of the way
from those of before to those of the step are (1 / r - 1) steps later, and what goes to and fro dies
out where r < 2 / (1 + 4 m / M) and r < 2 / (1 + m / M). Newton's lagged proxies of inertia M do as
euler does with r = M / (M + m).
"""

from collections.abc import Iterator

import newton
import numpy as np
import warp as wp

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

# Stiff beside what its mass does in a step: it moves as one.
_CABLE = RodMaterial.from_youngs_modulus(1e9, radius=0.002, length=0.3, density=1150.0)
_EDGES, _RATE, _AMPLITUDE = 6, 2.0 * np.pi, 0.01
STEP = 1.0 / 240.0


class Slider:
    """A slider that a cable hangs on, at its top where both are in balance, let go.

    Args:
        ratio: mass of the cable over that of the slider.
        scheme: of the cable.
        relaxation: of its loads.
    """

    def __init__(self, ratio: float, scheme: str, relaxation: float = 1.0):
        mass = _CABLE.weight / _CABLE.gravity * _CABLE.length
        whole = mass * (1.0 + 1.0 / ratio)
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        link = builder.add_link(mass=mass / ratio, inertia=wp.mat33(*(1e-3 * np.eye(3)).ravel()))
        stiffness = whole * _RATE**2
        joint = builder.add_joint_prismatic(
            -1, link, axis=wp.vec3(0.0, 0.0, 1.0), target_ke=stiffness, target_kd=0.0,
            target_q=whole * 9.81 / stiffness - _AMPLITUDE,
            actuator_mode=newton.JointTargetMode.POSITION,
        )  # fmt: skip
        builder.add_articulation([joint])
        points = np.linspace(0.0, -_CABLE.length, _EDGES + 1)[:, None] * [0.0, 0.0, 1.0]
        SolverDER.add_rod(
            builder, points, _CABLE, start="pinned", start_body=link, visible=False
        )  # fmt: skip
        self.model = model = builder.finalize(device="cpu")
        self._arm = newton.solvers.SolverFeatherstone(model)
        self._cable = SolverDER(model, scheme=scheme, tolerance=1e-8)
        self._cable.load_relaxation = relaxation
        self._link = link

    def run(self, steps: int, dt: float = STEP) -> np.ndarray:
        """(step,) heights over the balance [m]."""
        model, out = self.model, []
        state, other, control = model.state(), model.state(), model.control()
        newton.eval_fk(model, model.joint_q, model.joint_qd, state)
        for _ in range(steps):
            state.clear_forces()
            self._cable.add_body_forces(state)
            self._arm.step(state, other, control, None, dt)
            self._cable.step(state, other, None, None, dt, moved=other)
            state, other = other, state
            out.append(float(state.body_q.numpy()[self._link, 2]) + _AMPLITUDE)
        return np.array(out)


def period_and_rate(x: np.ndarray) -> tuple[float, float]:
    """Period [s], and rate at which the swing grows [1/s], of its maxima and minima."""
    i = np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0) + 1
    bend = x[i - 1] - 2.0 * x[i] + x[i + 1]
    slope = 0.5 * (x[i + 1] - x[i - 1])
    times, tops = STEP * (i - slope / bend), np.abs(x[i] - 0.5 * slope**2 / bend)
    half = np.polyfit(np.arange(len(times)), times, 1)[0]
    return 2.0 * float(half), float(np.polyfit(times, np.log(tops), 1)[0])


def trembles(ratio: float, scheme: str, relaxation: float = 1.0) -> bool:
    """Whether what goes to and fro from step to step stays: more than a swing's differences."""
    x = Slider(ratio, scheme, relaxation).run(400)
    return not np.abs(np.diff(x, 3)[-20:]).max() < 10.0 * _AMPLITUDE * (_RATE * STEP) ** 3


def measure() -> Iterator[tuple[str, str, str]]:
    """(what, found, expected) of one scene after the other, as text."""
    ratio = 0.2
    for scheme in ("bdf2", "euler"):
        period, rate = period_and_rate(Slider(ratio, scheme).run(1200))
        lag = -ratio / (1.0 + ratio) * _RATE**2 * STEP / 2.0 if scheme == "euler" else 0.0
        what = f"slider with a cable of {ratio} of its mass, {scheme}"
        yield f"{what}: period [s]", f"{period:.5f}", "1.00000"
        yield f"{what}: growth [1/s]", f"{rate:.5f}", f"{lag:.5f}"
    for scheme, limit in (("bdf2", 0.25), ("euler", 1.0)):
        ratios = 0.9 * limit, 1.2 * limit
        said = ", ".join("trembles" if trembles(r, scheme) else "swings" for r in ratios)
        yield f"the same at {ratios[0]:g} and {ratios[1]:g}, {scheme}", said, "swings, trembles"
    for ratio, scheme, limit in ((1.0, "bdf2", 0.4), (3.0, "euler", 0.5)):
        parts = 0.9 * limit, 1.2 * limit
        said = ", ".join("trembles" if trembles(ratio, scheme, r) else "swings" for r in parts)
        what = (
            f"with {ratio:g} of its mass, load_relaxation {parts[0]:g} and {parts[1]:g}, {scheme}"
        )
        yield what, said, "swings, trembles"
