"""A plectoneme of `wrod bench newton --bodies`: load of its ends against its angle."""

from collections.abc import Iterator
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from wrod.newton_solver import SolverDER
from wrod.patterns.curve import smoothstep
from wrod.rods.model import RodModel

_LENGTH, _SLACK, _RADIUS, _BENDING = 0.5, 0.38, 0.004, 1e-3
_NEARING, _TURNING, _RESTING, _RATE = 1.0, 3.0, 3.0, 60  # [s], [s], [s], [1/s]


@dataclass(frozen=True)
class Ply:
    """What two strands wound around each other are like far from their ends, where nothing rubs.

    Attributes:
        angle: between the strands and the axis.
        radius: half their distance over their radius.
        force, moment: F R^2 / B and M R / B of the cable's ends.
        speed: of the fastest node [m/s].
    """

    angle: float
    radius: float
    force: float
    moment: float
    speed: float

    def expected(self) -> tuple[float, float]:
        """Force and moment by the angle, from d/dl = d/d(angle) = 0 of the energy of a length l
        of ply, B sin^4 / (2 R^2) + F - M sin cos / R (Thompson, van der Heijden and Neukirch 2002).
        """
        s, c, c2 = np.sin(self.angle), np.cos(self.angle), np.cos(2.0 * self.angle)
        return s**4 * (2.0 * c**2 / c2 - 0.5), 2.0 * s**3 * c / c2


def wind(edges: int, turns: float) -> Ply:
    """Hands bring the ends of a cable nearer, then turn one of them."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverDER.register_custom_attributes(builder)
    t = np.linspace(0.0, 1.0, edges + 1)
    points = np.column_stack([_LENGTH * t, 0.0 * t, 1e-3 * np.sin(np.pi * t) ** 2])
    model = RodModel(
        length=_LENGTH, bending_stiffness=_BENDING, twisting_stiffness=2.0 * _BENDING,
        stretching_stiffness=4e3 * _BENDING / _RADIUS**2, line_mass=0.05, radius=_RADIUS,
    )  # fmt: skip
    hands = [builder.add_link(xform=wp.transform(points[k]), is_kinematic=True) for k in (0, -1)]
    SolverDER.add_rod(
        builder, points, model, start="clamped", start_body=hands[0], end="clamped",
        end_body=hands[1], air_damping=8.0, internal_damping=0.01, visible=False,
        rest_length=_LENGTH / edges, natural_curvature=np.zeros(2),
    )  # fmt: skip
    scene = builder.finalize(device="cpu")
    solver, state = SolverDER(scene, self_contact=0.0), scene.state()
    for k in range(round((_NEARING + _TURNING + _RESTING) * _RATE)):
        time = (k + 1) / _RATE
        half = np.pi * turns * smoothstep((time - _NEARING) / _TURNING)
        poses = state.body_q.numpy()
        poses[hands[1], 0] = _LENGTH - _SLACK * smoothstep(time / _NEARING)
        poses[hands[1], 3:] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        state.body_q.assign(poses)
        solver.step(state, state, None, None, 1.0 / _RATE)
    if solver.diverged.any():
        raise RuntimeError("the cable diverged")
    wrench = solver.body_wrenches()[hands[1]]
    angle, radius = ply_of(state.der.node_q.numpy().astype(float))
    return Ply(
        angle, radius / _RADIUS, -wrench[0] * radius**2 / _BENDING,
        abs(wrench[3]) * radius / _BENDING, float(np.abs(state.der.node_qd.numpy()).max()),
    )  # fmt: skip


def ply_of(q: np.ndarray) -> tuple[float, float]:
    """Angle of the strands to their axis, from how the way across turns along it, and half their
    distance [m]; of the middle half of what is wound."""
    half = len(q) // 2
    first, other, way = q[:half], q[half + 1 : -1], np.diff(q[half + 1 :], axis=0)
    s = np.sum((first[:, None] - other) * way, axis=2) / np.sum(way**2, axis=1)
    near = other + np.clip(s, 0.0, 1.0)[:, :, None] * way - first[:, None]
    distance = np.linalg.norm(near, axis=2)
    k = distance.argmin(axis=1)
    across = near[np.arange(half), k]
    wound = np.flatnonzero(distance.min(axis=1) < 2.2 * _RADIUS)
    wound = wound[len(wound) // 4 : -(len(wound) // 4)]
    across, axis = across[wound], first[wound] + 0.5 * across[wound]
    unit = across / np.linalg.norm(across, axis=1)[:, None]
    turned = np.arccos(np.clip(np.sum(unit[1:] * unit[:-1], axis=1), -1.0, 1.0)).sum()
    radius = 0.5 * float(np.linalg.norm(across, axis=1).mean())
    return float(np.arctan2(radius * turned, np.linalg.norm(axis[-1] - axis[0]))), radius


def measure() -> Iterator[tuple[str, str, str]]:
    """Rows of found and expected."""
    for edges, turns in ((320, 8.0), (160, 10.0), (320, 10.0), (320, 14.0)):
        ply = wind(edges, turns)
        force, moment = ply.expected()
        what = f"plectoneme of {edges} edges at {np.degrees(ply.angle):.2f} degrees"
        found = f"{ply.force:.4f}, {ply.moment:.4f}"
        yield f"{what}: F R^2 / B, M R / B", found, f"{force:.4f}, {moment:.4f}"
