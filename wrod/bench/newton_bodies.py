"""Scenes of `wrod bench newton --bodies`: cables that pull bodies, in Newton."""

import importlib.util
from collections.abc import Iterator

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.bench import newton_laid, newton_plectoneme
from wrod.bench.newton_piles import Pile
from wrod.newton_solver import SolverDER
from wrod.rods.batch import RodBatch
from wrod.rods.material import RodMaterial
from wrod.solvers.statics import prescribe, solve_equilibria

# A cable of nylon, which 10 kg stretch by 0.8 %, and one of rubber.
NYLON = RodMaterial.from_youngs_modulus(1e9, radius=0.002, length=0.5, density=1150.0)
RUBBER = RodMaterial(radius=0.0016, gravito_bending_length=0.032, length=0.2)
_EDGES = 20
_STIFFNESS, _DAMPING = 1000.0, 15.0  # of the arm's joints [N m/rad, N m s/rad]
_REACH, _CABLE, _PIECES = 0.4, 0.8, 24  # of its links and of its cable [m], and the cable's edges
# Of the slider. Stiff beside what its mass does in a step: it moves as one.
_TAUT = RodMaterial.from_youngs_modulus(1e9, radius=0.002, length=0.3, density=1150.0)
_PARTS, _RATE, _AMPLITUDE = 6, 2.0 * np.pi, 0.01
STEP = 1.0 / 240.0


def hung(
    material, mass, inertia, *, length=0.2, way=(0.0, 0.0, -1.0), gravity=-9.81, start="free",
    end="clamped", centre=(0.0, 0.0, 0.0),
):  # fmt: skip
    """A model of one cable of 20 edges with a free body at its end, and the body's index."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, gravity))
    SolverDER.register_custom_attributes(builder)
    points = np.linspace(0.0, length, _EDGES + 1)[:, None] * np.array(way)
    body = builder.add_body(
        xform=wp.transform(tuple(points[-1]), wp.quat_identity()), mass=mass,
        inertia=wp.mat33(*np.diag(inertia).ravel()), com=wp.vec3(*centre),
    )  # fmt: skip
    SolverDER.add_rod(builder, points, material, start=start, end=end, end_body=body, visible=False)
    return builder.finalize(device="cpu"), body


def simulate(model, steps, dt, state=None, each=None, **options):
    """Solver and state after some steps, `each(k, state)` called after every one."""
    solver = SolverDER(model, **options)
    state = model.state() if state is None else state
    for k in range(steps):
        solver.step(state, state, None, None, dt)
        if each is not None:
            each(k, state)
    return solver, state


def period_of(samples, dt: float) -> float:
    """Mean period of what swings about 0 [s]; not a number of what does not."""
    x = np.array(samples)
    i = np.flatnonzero(x[:-1] * x[1:] < 0)
    crossings = i + x[i] / (x[i] - x[i + 1])
    return 2.0 * np.diff(crossings).mean() * dt if len(crossings) > 1 else float("nan")


def momentum(scheme: str, inertia: str = "lumped") -> float:
    """Error of the momentum of a falling cable with a body as heavy as itself, over what it is."""
    steps, dt = 60, 0.004
    model, body = hung(
        RUBBER, 0.002, (2e-7, 3e-7, 4e-7), way=(1.0, 0.0, 0.0), centre=(0.01, 0.003, 0.002)
    )
    node_mass, mass = model.der.node_mass.numpy(), float(model.body_mass.numpy()[body])
    state = model.state()
    velocity = np.zeros((_EDGES + 1, 3))
    velocity[8:18, 1] = 1.0
    state.der.node_qd.assign(velocity)
    solver, state = simulate(
        model, steps, dt, state, scheme=scheme, inertia=inertia, tolerance=1e-9
    )
    last = node_mass @ state.der.node_qd.numpy()
    last += mass * solver._groups[0].bodies.velocity.numpy()[0, 0]
    fall = steps * dt * np.array(model.gravity.numpy()[0], dtype=float)
    expected = node_mass @ velocity + (mass + node_mass.sum()) * fall
    return float(np.abs(last - expected).max() / np.linalg.norm(expected))


def pendulum() -> tuple[float, float]:
    """Period of a bob on a cable pinned at both ends, and 2 pi sqrt(l / g) [s]."""
    mass, length = 0.7, 0.5
    model, body = hung(NYLON, mass, (1e-5,) * 3, length=length, start="pinned", end="pinned")
    _, state = simulate(model, 60, 0.05, scheme="euler")  # the cable takes its length
    long = -float(state.body_q.numpy()[body, 2])
    cable = NYLON.weight / NYLON.gravity * length
    arm = (mass + cable / 3.0) * long / (mass + cable / 2.0)
    expected = 2.0 * np.pi * np.sqrt(arm / 9.81)
    motion, velocity = state.body_qd.numpy(), state.der.node_qd.numpy()
    motion[body, 0] = 0.05
    velocity[:, 0] = 0.05 * -state.der.node_q.numpy()[:, 2] / long
    state.body_qd.assign(motion)
    state.der.node_qd.assign(velocity)
    dt, places = expected / 80, []
    simulate(
        model, 240, dt, state, lambda k, s: places.append(s.body_q.numpy()[body, 0]),
        scheme="midpoint",
    )  # fmt: skip
    return period_of(places, dt), expected


def torsion(scheme: str) -> tuple[float, float]:
    """Period of a disc that a cable turns, and 2 pi sqrt((I + J / 3) L / GJ) [s]."""
    inertia, length = 2e-7, 0.2
    model, body = hung(RUBBER, 1e-3, (1e-6, 1e-6, inertia), gravity=0.0, start="clamped")
    stiffness = model.der.node_twisting_stiffness.numpy()[1]
    own = 0.5 * RUBBER.radius**2 * RUBBER.weight / RUBBER.gravity * length
    expected = 2.0 * np.pi * np.sqrt((inertia + own / 3.0) * length / stiffness)
    state, rate = model.state(), np.pi / expected
    motion = state.body_qd.numpy()
    motion[body, 5] = rate
    state.body_qd.assign(motion)
    state.der.edge_spin.assign(-rate * (np.arange(_EDGES) + 0.5) / _EDGES)
    turns = []

    def note(k, state):
        q = state.body_q.numpy()[body]
        turns.append(2.0 * np.arctan2(q[5], q[6]))

    dt = expected / 100
    simulate(model, 260, dt, state, note, scheme=scheme, tolerance=1e-8)
    return period_of(turns, dt), expected


def hanging(mass: float) -> tuple[float, float]:
    """Force at the top of a cable with a mass at its end, and both weights [N]."""
    model, body = hung(NYLON, mass, (1e-5 * mass,) * 3, length=0.5, start="clamped", end="pinned")
    solver, _ = simulate(model, 150, 0.05, scheme="euler", tolerance=1e-9)
    reaction = solver._groups[0].dynamics.reaction.numpy()[0]
    total = float(model.body_mass.numpy()[body]) + model.der.node_mass.numpy().sum()
    return float(reaction[2] + reaction[6]), total * 9.81


def step_both(mover, cable: SolverDER, state, other, control, dt: float) -> None:
    """A step of another solver with the loads of the cable's last, then one of the cable."""
    state.clear_forces()
    cable.add_body_forces(state)
    mover.step(state, other, control, None, dt)
    cable.step(state, other, None, None, dt, moved=other)


class Slider:
    """A slider that a cable hangs on, at its top where both are in balance, let go: its loads are
    those of the step before.

    A slider of mass M on a spring k, moved by SolverFeatherstone, holds a taut cable of mass m.
    With what the cable did at the end of the last step, Featherstone's steps of length h are

        M (x_(n+1) - 2 x_n + x_(n-1)) / h^2 = -k x_n - m a_n,

    a_n the acceleration that the cable's scheme sees: in phase with the left side where it is of
    second order (bdf2), a step late with euler, which damps by m / (M + m) w^2 h / 2. What goes to
    and fro from step to step, x_n = (-1)^n, has a_n = 16 x_n / h^2 with bdf2 and 4 x_n / h^2 with
    euler, and dies out where M > 4 m and M > m, however short the step. Loads that go by a share r
    of the way from those of before to those of the step are (1 / r - 1) steps later, and what goes
    to and fro dies out where r < 2 / (1 + 4 m / M) and r < 2 / (1 + m / M). Newton's lagged proxies
    of inertia M do as euler does with r = M / (M + m).

    Args:
        ratio: mass of the cable over that of the slider.
        scheme: of the cable.
        relaxation: of its loads.
    """

    def __init__(self, ratio: float, scheme: str, relaxation: float = 1.0):
        mass = _TAUT.weight / _TAUT.gravity * _TAUT.length
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
        points = np.linspace(0.0, -_TAUT.length, _PARTS + 1)[:, None] * [0.0, 0.0, 1.0]
        SolverDER.add_rod(
            builder, points, _TAUT, start="pinned", start_body=link, visible=False
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
            step_both(self._arm, self._cable, state, other, control, dt)
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
    x = Slider(ratio, scheme, relaxation).run(200)
    return not np.abs(np.diff(x, 3)[-20:]).max() < 10.0 * _AMPLITUDE * (_RATE * STEP) ** 3


class TwoLinkArm:
    """Two links that a solver of Newton's moves, and a cable from their tip to a pin.

    Args:
        mujoco: SolverMuJoCo moves the links, on the CPU; otherwise SolverFeatherstone.
        visible: the cable is shown by capsules, which are bodies for the links' solver too.

    Attributes:
        model, state, arm, cable: Newton's, at rest after `settle`.
        links: indices of the bodies.
    """

    def __init__(self, *, mujoco: bool = False, visible: bool = False):
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        cfg = newton.ModelBuilder.ShapeConfig(density=800.0, has_shape_collision=False)
        self.links, joints = [], []
        for k in range(2):
            link = builder.add_link(
                xform=wp.transform(((k + 0.5) * _REACH, 0.0, 1.0), wp.quat_identity())
            )
            builder.add_shape_box(link, hx=0.5 * _REACH, hy=0.03, hz=0.03, cfg=cfg)
            before = (0.0, 0.0, 1.0) if k == 0 else (0.5 * _REACH, 0.0, 0.0)
            joint = builder.add_joint_revolute(
                -1 if k == 0 else self.links[0], link,
                parent_xform=wp.transform(before, wp.quat_identity()),
                child_xform=wp.transform((-0.5 * _REACH, 0.0, 0.0), wp.quat_identity()),
                axis=wp.vec3(0.0, 1.0, 0.0), target_ke=_STIFFNESS, target_kd=_DAMPING,
                actuator_mode=newton.JointTargetMode.POSITION,
            )  # fmt: skip
            self.links.append(link)
            joints.append(joint)
        builder.add_articulation(joints)
        self.material = RodMaterial.from_youngs_modulus(5e7, 0.004, _CABLE, density=1150.0)
        arc = np.linspace(0.0, _CABLE, _PIECES + 1)
        points = np.array([2.0 * _REACH, 0.0, 1.0]) + arc[:, None] * [0.8, 0.0, -0.6]
        self.rest = _CABLE / _PIECES
        SolverDER.add_rod(
            builder, points, self.material, start="clamped", start_body=self.links[1],
            end="pinned", air_damping=3.0, visible=visible,
        )  # fmt: skip
        self.model = builder.finalize(device="cpu")
        if mujoco:
            self.arm = newton.solvers.SolverMuJoCo(self.model, use_mujoco_cpu=True)
        else:
            self.arm = newton.solvers.SolverFeatherstone(self.model)
        self.cable = SolverDER(self.model, scheme="euler")
        self.state, self._other = self.model.state(), self.model.state()
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.state)

    def settle(self, steps: int = 3600, dt: float = 0.001) -> None:
        """Let both move on, turn by turn."""
        control = self.model.control()
        for _ in range(steps):
            step_both(self.arm, self.cable, self.state, self._other, control, dt)
            self.state, self._other = self._other, self.state

    def torques(self) -> np.ndarray:
        """(2,) what the joints' springs do [N m]."""
        q, rate = self.state.joint_q.numpy(), self.state.joint_qd.numpy()
        return -_STIFFNESS * q - _DAMPING * rate

    def statics(self) -> np.ndarray:
        """(2,) torques that hold the links and the cable, whose shape `solve_equilibria` finds
        between the same clamp and pin: moments of all weights and of the pin's force [N m]."""
        nodes = self.state.der.node_q.numpy()
        poses = self.state.body_q.numpy()[self.links].astype(float)
        turned = Rotation.from_quat(poses[1, 3:]).apply([0.8, 0.0, -0.6])
        ghost = nodes[0] - self.rest * turned
        arc = np.arange(-1, len(nodes)) * self.rest
        guess = np.vstack([ghost, nodes])
        batch = RodBatch.of(self.material, arc, guess[None], clamped=(True, False))
        prescribe(batch, clamped_nodes=(0, 1), pinned_nodes=(-1,), clamped_angles=(0,))
        if not solve_equilibria(batch).converged.all():
            return np.full(2, np.nan)
        q = batch.positions()[0, 1:]
        pin = batch.evaluate(order=1).gradient.numpy()[0, -3:]
        weight = np.zeros_like(q)
        weight[:, 2] = -9.81 * self.model.der.node_mass.numpy()
        masses = self.model.body_mass.numpy()[self.links]
        elbow = poses[0, :3] + Rotation.from_quat(poses[0, 3:]).apply([0.5 * _REACH, 0.0, 0.0])
        out = []
        for k, joint in enumerate((np.array([0.0, 0.0, 1.0]), elbow)):
            moment = np.cross(q - joint, weight).sum(axis=0) + np.cross(q[-1] - joint, pin)
            for pose, mass in list(zip(poses, masses, strict=True))[k:]:
                moment = moment + np.cross(pose[:3] - joint, [0.0, 0.0, -9.81 * mass])
            out.append(-moment[1])
        return np.array(out)


def measure() -> Iterator[tuple[str, str, str]]:
    """(what, found, expected) of one scene after the other, as text."""
    for scheme in ("euler", "bdf2", "midpoint"):
        error = momentum(scheme)
        yield f"momentum of a falling cable and body, {scheme}", f"{error:.1e}", "0"
    for mass in (1e-6, 0.2, 10.0):
        force, expected = hanging(mass)
        yield f"force at the top under {mass:g} kg [N]", f"{force:.6g}", f"{expected:.6g}"
    found, expected = pendulum()
    yield "period of a heavy pendulum [s]", f"{found:.5f}", f"{expected:.5f}"
    for scheme in ("bdf2", "midpoint"):
        found, expected = torsion(scheme)
        yield f"torsional period, {scheme} [s]", f"{found:.5f}", f"{expected:.5f}"
    for mujoco in (False, True) if importlib.util.find_spec("mujoco_warp") else (False,):
        arm = TwoLinkArm(mujoco=mujoco)
        arm.settle()
        mover = "MuJoCo" if mujoco else "Featherstone"
        for name, found, expected in zip(
            ("shoulder", "elbow"), arm.torques(), arm.statics(), strict=True
        ):
            what = f"{name} that holds a cable, {mover} [N m]"
            yield what, f"{found:.4f}", f"{expected:.4f}"
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
    yield from newton_laid.measure()
    pile = Pile()
    cost = pile.run(90)
    yield "pile of 6 cables of 20 edges: deepest over radius", f"{pile.deepest:.4f}", "0"
    yield "the same: CPU seconds per simulated second", f"{cost:.2f}", ""
    yield from newton_plectoneme.measure()  # last: they take most of the time
