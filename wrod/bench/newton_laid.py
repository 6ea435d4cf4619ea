"""Scenes of `wrod bench newton --bodies`: rods that touch shapes on free bodies, and bodies of rods
that touch the ground and each other."""

from collections.abc import Iterator

import newton
import numpy as np
import warp as wp

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

CABLE = RodMaterial(radius=0.003, gravito_bending_length=0.1, length=0.6, density=1200.0)
BAR = RodMaterial.from_youngs_modulus(1e11, radius=0.004, length=0.6, density=1200.0)
BOX = (0.03, 0.06, 0.02)  # half sizes [m]
# Light beside the bodies that it hangs from, so that these do what they do alone.
THREAD = RodMaterial(radius=0.0005, gravito_bending_length=0.05, length=0.1, density=100.0)
SIZE = 0.02  # radius of a ball, half edge of a box [m]
_THREAD_EDGES, _THREAD_LENGTH = 4, 0.04
_G = 9.81
_STEP = 1.0 / 240.0


class Simulation:
    """Rods and bodies in one world; bodies that hold none are moved by the solver too.

    Attributes:
        builder, model, solver, state: Newton's; the last three from `begin` on.
    """

    label = "laid"  # of its bodies

    def __init__(self, gravity=(0.0, 0.0, -_G), mu: float = 0.5, density: float = 500.0):
        self.cfg = newton.ModelBuilder.ShapeConfig(density=density, mu=mu)
        self.builder = newton.ModelBuilder(gravity=tuple(gravity))
        SolverDER.register_custom_attributes(self.builder)
        self._bodies: list[int] = []

    def box(self, at, half=BOX, turn=None) -> int:
        """A body with a box."""
        body = self._body(at, turn)
        hx, hy, hz = half
        self.builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, cfg=self.cfg)
        return body

    def ball(self, at, radius: float = SIZE) -> int:
        """A body with a ball."""
        body = self._body(at, None)
        self.builder.add_shape_sphere(body, radius=radius, cfg=self.cfg)
        return body

    def _body(self, at, turn) -> int:
        turn = wp.quat_identity() if turn is None else turn
        self._bodies.append(self.builder.add_body(xform=wp.transform(at, turn), label=self.label))
        return self._bodies[-1]

    def rod(self, points, material: RodMaterial = CABLE, **options) -> int:
        given = {"internal_damping": 0.01, "visible": False} | options
        return SolverDER.add_rod(self.builder, points, material, **given)

    def begin(self, device: str = "cpu", **options) -> None:
        self.model = self.builder.finalize(device=device)
        self.solver = SolverDER(self.model, **({"bodies": self._bodies} | options))
        self.state = self.model.state()

    def throw(self, body, velocity) -> None:
        """Give a body, or bodies, a velocity [m/s]."""
        motion = self.state.body_qd.numpy().copy()
        motion[body, :3] = velocity
        self.state.body_qd.assign(motion)

    def run(self, steps: int, dt: float = _STEP, body: int = 0) -> np.ndarray:
        """(step, 3) places of a body after every step. Bodies touch nothing but rods."""
        out = []
        for _ in range(steps):
            contacts = newton.Contacts(0, 0, device=self.model.device)
            self.solver.step(self.state, self.state, None, contacts, dt)
            out.append(self.state.body_q.numpy()[body, :3].copy())
        return np.array(out)

    def pressed(self) -> np.ndarray:
        """(3,) sum of the forces on the rods [N]."""
        return self.state.der.node_contact_f.numpy().sum(axis=0)

    def weight(self, body: int | None = None) -> float:
        """Of a body, or of all bodies and rods [N]."""
        mass = self.model.body_mass.numpy()
        if body is not None:
            return _G * float(mass[body])
        return _G * (float(mass[self._bodies].sum()) + self.model.der.node_mass.numpy().sum())

    def momentum(self) -> np.ndarray:
        """(6,) of all rods and bodies: linear, and angular about the origin, in float64."""
        (group,) = self.solver._groups
        bodies, rods = group.bodies, group.dynamics
        mass = bodies.body.numpy()[0]["mass"][:, None]
        at, velocity = bodies.place.numpy()[0], bodies.velocity.numpy()[0]
        node_mass = group.batch.node_mass.numpy()[0][:, None]
        nodes, rates = group.batch.positions()[0], rods.velocities()[0]
        linear = (mass * velocity).sum(axis=0) + (node_mass * rates).sum(axis=0)
        angular = bodies.momentum.numpy()[0].sum(axis=0)
        angular = angular + np.cross(at, mass * velocity).sum(axis=0)
        angular = angular + np.cross(nodes, node_mass * rates).sum(axis=0)
        return np.concatenate([linear, angular])


def along(axis: int, length: float, edges: int, at=(0.0, 0.0, 0.0)) -> np.ndarray:
    """(node, 3) points of a straight rod along an axis, its middle in a place."""
    points = np.tile(np.asarray(at, dtype=float), (edges + 1, 1))
    points[:, axis] += np.linspace(-0.5 * length, 0.5 * length, edges + 1)
    return points


def borne(density: float, device: str = "cpu") -> tuple[float, float, Simulation]:
    """A box lies down on two cables that are clamped at both ends: force on the cables at rest, and
    the box's weight [N].

    One of 14 kg would tip over: over its height its weight turns it more than the cables, eight
    centimetres apart, turn it back.
    """
    simulation = Simulation(density=density)
    for y in (-0.04, 0.04):
        simulation.rod(
            along(0, 0.6, 30, (0.0, y, 0.0)), start="clamped", end="clamped", air_damping=5
        )
    box = simulation.box((0.0, 0.0, 0.0231))
    simulation.begin(device, scheme="euler", tolerance=1e-9)
    simulation.run(150, 0.05)
    return -float(simulation.pressed()[2]), simulation.weight(box), simulation


def acceleration_of(x: np.ndarray) -> float:
    """Of places along a way, one a step, in their second half [m/s^2]."""
    half, t = len(x) // 2, _STEP * np.arange(1, len(x) + 1)
    return 2.0 * float(np.polyfit(t[half:], x[half:], 2)[0])


def slide(angle: float, device: str = "cpu") -> float:
    """Acceleration of a box on two stiff bars down a slope [m/s^2]."""
    simulation = Simulation((_G * np.sin(angle), 0.0, -_G * np.cos(angle)))
    for y in (-0.04, 0.04):
        simulation.rod(along(0, 0.6, 30, (0.0, y, 0.0)), BAR, start="clamped", end="clamped")
    box = simulation.box((-0.1, 0.0, 0.024))
    simulation.begin(device)
    return acceleration_of(simulation.run(96, body=box)[:, 0])


def collision(scheme: str, device: str = "cpu") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Momentum (6,) of all before and after a ball has hit a cable afloat, beside its middle, and
    the ball's velocity and spin (6,) then."""
    simulation = Simulation((0.0, 0.0, 0.0), mu=0.3)
    simulation.rod(along(1, 0.6, 30), air_damping=0.0)
    ball = simulation.ball((-0.03, 0.05, 0.002))
    simulation.begin(device, scheme=scheme, tolerance=1e-12, max_step=0.5 * _STEP)
    simulation.throw(ball, (1.0, 0.0, 0.0))
    simulation.run(1, body=ball)
    before = simulation.momentum()
    simulation.run(60, body=ball)
    return before, simulation.momentum(), simulation.state.body_qd.numpy()[ball].copy()


def over_its_block(device: str = "cpu") -> tuple[float, float, float]:
    """A block hangs on one cable and holds another, which hangs down over its edge: force at the
    top and the weight of all [N]; the force with which the block bears its own cable [N]."""
    simulation = Simulation()
    block = simulation.box((0.0, 0.0, 0.0), (0.02, 0.02, 0.02))
    simulation.rod(along(2, 0.2, 10, (0.0, 0.0, 0.12)), start="pinned", start_body=block,
              end="clamped", air_damping=5.0)  # fmt: skip
    over = along(0, 0.3, 30, (0.15, 0.0, 0.0231))
    held = simulation.rod(over, start="clamped", start_body=block, air_damping=5.0)
    simulation.begin(device, scheme="euler", tolerance=1e-9)
    simulation.run(200, 0.05, block)
    der = simulation.model.der
    reaction = simulation.solver._groups[0].dynamics.reaction.numpy()[0]
    top = float(reaction.reshape(-1)[: 4 * 12].reshape(-1, 4)[-2:, 2].sum())
    first, count = der.rod_first_node.numpy()[held], der.rod_node_count.numpy()[held]
    pressing = simulation.state.der.node_contact_f.numpy()[first : first + count]
    return top, simulation.weight(), float(pressing[:, 2].sum())


class Plugs(Simulation):
    """Boxes or balls, each with a thread at its top, stepped with Newton's contacts.

    Attributes:
        bodies: their indices.
        contacts: Newton's, from `begin` on.
    """

    label = "plug"

    def __init__(
        self, places, *, round_ones: bool = False, mu: float = 0.5, angle: float = 0.0,
        ground: bool = True, gravity: float = _G,
    ):  # fmt: skip
        super().__init__(gravity * np.array([np.sin(angle), 0.0, -np.cos(angle)]), mu, 1000.0)
        if ground:
            self.builder.add_ground_plane(cfg=self.cfg)
        line = np.linspace(0.0, _THREAD_LENGTH, _THREAD_EDGES + 1)[:, None] * [0.0, 0.0, 1.0]
        for place in places:
            body = self.ball(place) if round_ones else self.box(place, (SIZE, SIZE, SIZE))
            self.rod(line + place, THREAD, start="clamped", start_body=body)
        self.bodies = self._bodies

    def begin(self, device: str = "cpu", velocity=0.0, **options) -> None:
        """Make model and solver; velocity (body, 3) of bodies and threads."""
        super().begin(device, bodies="free", **options)
        velocity = np.broadcast_to(np.asarray(velocity, dtype=float), (len(self.bodies), 3))
        self.throw(self.bodies, velocity)
        self.state.der.node_qd.assign(np.repeat(velocity, _THREAD_EDGES + 1, axis=0))
        self._detection = newton.CollisionPipeline(self.model)
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


def acceleration(angle: float, *, round_ones: bool = False) -> float:
    """Of a box or a ball down a slope, from rest, once it has settled [m/s^2]."""
    scene = Plugs([(0.0, 0.0, SIZE)], round_ones=round_ones, angle=angle)
    scene.begin()
    # A ball rolls onto its thread in the end.
    return acceleration_of(scene.run(48 if round_ones else 96)[:, 0, 0])


def measure() -> Iterator[tuple[str, str, str]]:
    """(what, found, expected) of one simulation after the other, as text."""
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
    for density in (0.5, 500.0, 5000.0):
        found, expected, simulation = borne(density)
        deep = float(simulation.solver._groups[0].contact.penetration()[0]) / CABLE.radius
        what = f"force of a box of {expected / _G:.2g} kg on two cables [N]"
        yield what, f"{found:.7g}", f"{expected:.7g}"
        yield "the same: depth over the radius", f"{deep:.4f}", "0"
    for scheme in ("euler", "bdf2", "midpoint"):
        before, after, _ = collision(scheme)
        error = np.abs(after[:3] - before[:3]).max() / before[0]
        yield f"momentum of a ball that hits a cable, {scheme}", f"{error:.1e}", "0"
    for angle in (0.4, 0.6):
        found = slide(angle)
        expected = max(0.0, _G * (np.sin(angle) - 0.5 * np.cos(angle)))
        what = f"box on two bars, slope {angle} rad, mu 0.5: acceleration [m/s^2]"
        yield what, f"{found:.5f}", f"{expected:.5f}"
    top, whole, _ = over_its_block()
    what = "force at the top of a block with a cable over its edge [N]"
    yield what, f"{top:.7g}", f"{whole:.7g}"
