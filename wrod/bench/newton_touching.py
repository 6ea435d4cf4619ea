"""Scenes of `wrod bench newton --bodies`: bodies of cables that touch the ground and each other."""

from collections.abc import Iterator

import newton
import numpy as np
import warp as wp

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

# Light beside the bodies that it hangs from, so that these do what they do alone.
THREAD = RodMaterial(radius=0.0005, gravito_bending_length=0.05, length=0.1, density=100.0)
SIZE = 0.02  # radius of a ball, half edge of a box [m]
_EDGES, _LENGTH = 4, 0.04
_STEP = 1.0 / 240.0


class Plugs:
    """Boxes or balls, each with a thread at its top, stepped with Newton's contacts.

    Attributes:
        builder, model, solver, state, contacts: Newton's; the last from `begin` on.
        bodies: their indices.
    """

    def __init__(
        self, places, *, round_ones: bool = False, mu: float = 0.5, angle: float = 0.0,
        ground: bool = True, gravity: float = 9.81,
    ):  # fmt: skip
        self.cfg = newton.ModelBuilder.ShapeConfig(density=1000.0, mu=mu)
        down = gravity * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        self.builder = builder = newton.ModelBuilder(gravity=tuple(down))
        SolverDER.register_custom_attributes(builder)
        if ground:
            builder.add_ground_plane(cfg=self.cfg)
        line = np.linspace(0.0, _LENGTH, _EDGES + 1)[:, None] * [0.0, 0.0, 1.0]
        self.bodies = []
        for place in places:
            body = builder.add_body(xform=wp.transform(place, wp.quat_identity()), label="plug")
            if round_ones:
                builder.add_shape_sphere(body, radius=SIZE, cfg=self.cfg)
            else:
                builder.add_shape_box(body, hx=SIZE, hy=SIZE, hz=SIZE, cfg=self.cfg)
            SolverDER.add_rod(
                builder, line + place, THREAD, start="clamped", start_body=body, visible=False,
                internal_damping=0.01,
            )  # fmt: skip
            self.bodies.append(body)

    def begin(self, velocity=0.0, **options) -> None:
        """Make model and solver; velocity (body, 3) of bodies and threads."""
        self.model = model = self.builder.finalize(device="cpu")
        self.solver, self.state = SolverDER(model, **options), model.state()
        velocity = np.broadcast_to(np.asarray(velocity, dtype=float), (len(self.bodies), 3))
        motion = self.state.body_qd.numpy().copy()
        motion[self.bodies, :3] = velocity
        self.state.body_qd.assign(motion)
        self.state.der.node_qd.assign(np.repeat(velocity, _EDGES + 1, axis=0))
        self._detection = newton.CollisionPipeline(model)
        self.contacts = self._detection.contacts()

    def run(self, steps: int, dt: float = _STEP, each=None) -> np.ndarray:
        """(step, body, 3) places after every step; `each(k, state)` is called before."""
        out = []
        for k in range(steps):
            if each is not None:
                each(k, self.state)
            self._detection.collide(self.state, self.contacts)
            self.solver.step(self.state, self.state, None, self.contacts, dt)
            out.append(self.state.body_q.numpy()[self.bodies, :3])
        return np.array(out)

    def pressed(self) -> np.ndarray:
        """(3,) sum of the forces with which the bodies of the first group press on others [N]."""
        return self.solver._groups[0].body_contact._force.numpy().sum(axis=0)

    def weight(self) -> float:
        """Of all bodies and threads [N]."""
        mass = self.model.body_mass.numpy()[self.bodies].sum()
        return 9.81 * (float(mass) + self.model.der.node_mass.numpy().sum())


def acceleration(angle: float, *, round_ones: bool = False) -> float:
    """Of a box or a ball down a slope, from rest, once it has settled [m/s^2]."""
    scene = Plugs([(0.0, 0.0, SIZE)], round_ones=round_ones, angle=angle)
    scene.begin()
    steps = 48 if round_ones else 96  # a ball rolls onto its thread in the end
    x, t = scene.run(steps)[:, 0, 0], _STEP * np.arange(1, steps + 1)
    return 2.0 * float(np.polyfit(t[steps // 2 :], x[steps // 2 :], 2)[0])


def measure() -> Iterator[tuple[str, str, str]]:
    """(what, found, expected) of one scene after the other, as text."""
    scene = Plugs([(0.0, 0.0, 0.05)])
    scene.begin()
    height = scene.run(120)[:, 0, 2] - SIZE
    landed = int(np.argmax(height < 0.0))
    found, expected = -scene.pressed()[2], scene.weight()
    yield "force on the ground of a box and its cable [N]", f"{found:.6g}", f"{expected:.6g}"
    rebound = max(0.0, float(height[landed:].max()))
    yield "the same, dropped from 3 cm: rebound [mm]", f"{1e3 * rebound:.2g}", "0"
    for angle in (0.4, 0.6):
        found = acceleration(angle)
        expected = max(0.0, 9.81 * (np.sin(angle) - 0.5 * np.cos(angle)))
        what = f"box on a slope of {angle} rad, mu 0.5: acceleration [m/s^2]"
        yield what, f"{found:.5f}", f"{expected:.5f}"
    found, expected = acceleration(0.2, round_ones=True), 5.0 / 7.0 * 9.81 * np.sin(0.2)
    yield "ball on a slope of 0.2 rad [m/s^2]", f"{found:.5f}", f"{expected:.5f}"
