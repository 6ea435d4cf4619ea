"""Worlds of a cable that a hand holds, or an arm: what `wrod.bench.newton_many` times."""

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

# A soft cable of the size that Newton's examples have, hung from a hand that goes to and fro.
CABLE = RodMaterial.from_youngs_modulus(5e6, radius=0.005, length=0.8, density=1150.0)
_AMPLITUDE, _RATE = 0.05, 2.0 * np.pi  # of the hand [m], [rad/s]
# Two links of this length [m] and mass [kg], and a hand; control and armature of the joints.
_REACH, _MASS, _HAND = 0.3, 0.5, 0.1
_STIFFNESS, _DAMPING, _ARMATURE = (900.0, 400.0, 60.0), (40.0, 16.0, 3.0), (0.2, 0.1, 0.05)
_SWING = 0.08  # of the shoulder's target [rad]
_STEP = 1.0 / 240.0  # longest of the arm's own steps [s]: Featherstone's are explicit


@wp.kernel
def move_hands(
    # Model:
    step: wp.float64,
    amplitude: wp.float64,
    rate: wp.float64,
    stride: int,
    start: wp.array[wp.transform],
    # State in and out:
    time: wp.array[wp.float64],
    # State out:
    body_q: wp.array[wp.transform],
):
    """Put every world's first body to where it is at the end of the step."""
    w = wp.tid()
    time[w] = time[w] + step
    way = amplitude * (wp.float64(1.0) - wp.cos(rate * time[w]))
    pose = start[stride * w]
    offset = wp.vec3(0.0, 0.0, wp.float32(way))
    body_q[stride * w] = wp.transform(
        wp.transform_get_translation(pose) + offset, wp.transform_get_rotation(pose)
    )


class Graphed:
    """Steps there and back between the two `_states` of a `model`; two of them are a graph."""

    model: newton.Model
    _states: list[newton.State]
    _graph = None

    def _step(self) -> None:
        """From the first state to the second."""
        raise NotImplementedError

    def step(self) -> None:
        """Two steps, there and back: what a graph can hold."""
        for _ in range(2):
            self._step()
            self._states.reverse()

    def launch(self, steps: int) -> None:
        for _ in range(steps // 2):
            self.step()

    def advance(self, steps: int) -> None:
        """As `launch`, but from a graph."""
        if self._graph is None:
            self.step()  # compiles
            with wp.ScopedCapture(device=self.model.device) as capture:
                self.step()
            self._graph, steps = capture.graph, steps - 2
        for _ in range(steps // 2):
            wp.capture_launch(self._graph)


class _Held(Graphed):
    """Worlds of which the first body goes to and fro, in steps of `dt` [s]."""

    dt: float

    def _make_hands(self, worlds: int) -> None:
        self._start, self._worlds = wp.clone(self.model.body_q), worlds
        self._time = wp.zeros(worlds, dtype=wp.float64, device=self.model.device)

    def _move_hands(self) -> None:
        wp.launch(
            move_hands,
            self._worlds,
            [wp.float64(self.dt), wp.float64(_AMPLITUDE), wp.float64(_RATE)]
            + [self.model.body_count // self._worlds, self._start, self._time],
            [self._states[0].body_q],
            device=self.model.device,
        )


class HeldDer(_Held):
    """Worlds of one cable that hangs along x, its upper end clamped by a kinematic body."""

    def __init__(
        self, worlds: int, edges: int, dt: float, device: str, requires_grad: bool = False
    ):
        x = np.linspace(0.0, CABLE.length, edges + 1)
        world = newton.ModelBuilder(gravity=(CABLE.gravity, 0.0, 0.0))
        SolverDER.register_custom_attributes(world)
        hand = self._add_hand(world)
        SolverDER.add_rod(
            world, np.column_stack([x, 0 * x, 0 * x]), CABLE, start="clamped", start_body=hand,
            visible=False,
        )  # fmt: skip
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        builder.replicate(world, worlds)
        model = self.model = builder.finalize(device=device, requires_grad=requires_grad)
        self.dt, self._solver = dt, SolverDER(model)
        self._states = [model.state(), model.state()]
        self._make_hands(worlds)
        self.last = (edges + 1) * (np.arange(worlds) + 1) - 1

    def _add_hand(self, world: newton.ModelBuilder) -> int:
        return world.add_body(is_kinematic=True)

    def _step(self) -> None:
        self._move_hands()
        state, other = self._states
        self._solver.step(state, other, None, None, self.dt)

    def tips(self) -> np.ndarray:
        if self._solver.diverged.any():
            return np.full((1, 3), np.nan)
        return self.state.der.node_q.numpy()[self.last]

    @property
    def state(self) -> newton.State:
        return self._states[0]


def weigh(model: newton.Model, mass: float) -> None:
    """Give every body of a cable of Newton's its mass [kg]: capsules overlap by their caps."""
    ratio = mass / model.body_mass.numpy()
    for name, power in (("mass", 1), ("inertia", 1), ("inv_mass", -1), ("inv_inertia", -1)):
        array = getattr(model, f"body_{name}")
        values = array.numpy()
        array.assign(values * ratio.reshape(-1, *[1] * (values.ndim - 1)) ** power)


class HeldVbd(_Held):
    """The same under Newton's own cable solver, in float32.

    Its first body is clamped: the continuum's clamp stands at that body's middle.
    """

    def __init__(self, worlds: int, edges: int, dt: float, device: str, iterations: int):
        edge = CABLE.length / (edges - 0.5)
        x = (np.arange(edges + 1) - 0.5) * edge
        world = newton.ModelBuilder(gravity=(CABLE.gravity, 0.0, 0.0))
        cable = newton.Rod(
            np.column_stack([x, 0 * x, 0 * x]), radius=CABLE.radius,
            youngs_modulus=CABLE.youngs_modulus,
            shear_modulus=CABLE.youngs_modulus / (2.0 * (1.0 + CABLE.poisson)),
        )  # fmt: skip
        bare = newton.ModelBuilder.ShapeConfig(density=CABLE.density, has_shape_collision=False)
        world.add_rod(rod=cable, cfg=bare, bend_damping=0.0)
        world.color()
        builder = newton.ModelBuilder()
        builder.replicate(world, worlds)
        model = self.model = builder.finalize(device=device)
        flags = model.body_flags.numpy()
        flags[::edges] = int(newton.BodyFlags.KINEMATIC)
        model.body_flags.assign(flags)
        weigh(model, CABLE.weight / CABLE.gravity * edge)
        self.dt, self._half = dt, 0.5 * edge
        self._rows = edges * (np.arange(worlds) + 1) - 1
        self._solver = newton.solvers.SolverVBD(model, iterations=iterations)
        self._control, self._states = model.control(), [model.state(), model.state()]
        self._make_hands(worlds)

    def tips(self) -> np.ndarray:
        pose = self._states[0].body_q.numpy()[self._rows].astype(float)
        return pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply([0.0, 0.0, self._half])

    def _step(self) -> None:
        self._move_hands()
        self._states[0].clear_forces()
        self._solver.step(*self._states, self._control, None, self.dt)


def add_arm(builder: newton.ModelBuilder) -> int:
    """A stretched arm along z whose hand, the body returned, is at the origin."""
    links: list[int] = []
    joints = []
    bare = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False)
    lengths, masses = (_REACH, _REACH, _HAND), (_MASS, _MASS, 0.2 * _MASS)
    z = -2.0 * _REACH
    for k, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        half = 0.5 * length if k < 2 else 0.0
        inertia = mass * length**2 / 12.0 * np.diag([1.0, 1.0, 0.1])
        link = builder.add_link(
            xform=wp.transform((0.0, 0.0, z + half), wp.quat_identity()), mass=mass,
            inertia=wp.mat33(*inertia.ravel()),
        )  # fmt: skip
        builder.add_shape_box(link, hx=0.02, hy=0.02, hz=0.5 * length, cfg=bare)
        before = (0.0, 0.0, z) if k == 0 else (0.0, 0.0, 0.5 * _REACH)
        joints.append(
            builder.add_joint_revolute(
                links[-1] if links else -1, link, axis=wp.vec3(0.0, 1.0, 0.0),
                parent_xform=wp.transform(before, wp.quat_identity()),
                child_xform=wp.transform((0.0, 0.0, -half), wp.quat_identity()),
                target_ke=_STIFFNESS[k], target_kd=_DAMPING[k], armature=_ARMATURE[k],
                actuator_mode=newton.JointTargetMode.POSITION,
            )
        )  # fmt: skip
        links.append(link)
        z += length
    builder.add_articulation(joints)
    return links[-1]


@wp.kernel
def set_targets(
    step: wp.float64,
    swing: wp.float64,
    rate: wp.float64,
    time: wp.array[wp.float64],
    target: wp.array[wp.float32],
):
    """Where the shoulders are told to be at the end of the step. Launched over worlds."""
    w = wp.tid()
    time[w] = time[w] + step
    target[3 * w] = wp.float32(swing * (wp.float64(1.0) - wp.cos(rate * time[w])))


@wp.kernel
def follow_hands(
    hand: wp.array[wp.transform],
    start: wp.array[wp.transform],
    stride: int,
    body_q: wp.array[wp.transform],
):
    """Put the first of `stride` bodies of every world to its hand, every third. Launched over
    worlds."""
    w = wp.tid()
    moved = hand[3 * w]
    body_q[stride * w] = moved * start[stride * w]


class _Arms:
    """What moves the arms of every world: `SolverFeatherstone`, in steps of its own."""

    def __init__(self, model: newton.Model, worlds: int, dt: float):
        self._solver = newton.solvers.SolverFeatherstone(model)
        self._control, self._spare = model.control(), model.state()
        self._time = wp.zeros(worlds, dtype=wp.float64, device=model.device)
        self._parts = int(np.ceil(dt / _STEP - 1e-9))
        self._dt, self._worlds = dt / self._parts, worlds

    def step(self, state: newton.State, other: newton.State, load=None) -> None:
        """Move on from one state to another; `load` adds forces to a state."""
        for part in range(self._parts):
            wp.launch(
                set_targets,
                self._worlds,
                [wp.float64(self._dt), wp.float64(_SWING), wp.float64(_RATE), self._time],
                [self._control.joint_target_q],
                device=self._time.device,
            )
            there = self._spare if (self._parts - part) % 2 == 0 else other
            state.clear_forces()
            if load is not None:
                load(state)
            self._solver.step(state, there, self._control, None, self._dt)
            state = there


class ArmedDer(HeldDer):
    """Worlds of one cable that hangs from an arm, which carries it."""

    def _add_hand(self, world: newton.ModelBuilder) -> int:
        return add_arm(world)

    def _make_hands(self, worlds: int) -> None:
        self._arms = _Arms(self.model, worlds, self.dt)

    def _step(self) -> None:
        state, other = self._states
        self._arms.step(state, other, self._solver.add_body_forces)
        self._solver.step(state, other, None, None, self.dt, moved=other)


class ArmedVbd(HeldVbd):
    """The same cable under Newton's own solver: its upper end goes with the hand of an arm, which
    does not feel it."""

    def _make_hands(self, worlds: int) -> None:
        cables = self.model
        world = newton.ModelBuilder(gravity=(CABLE.gravity, 0.0, 0.0))
        add_arm(world)
        builder = newton.ModelBuilder()
        builder.replicate(world, worlds)
        model = builder.finalize(device=cables.device)
        self._start, self._worlds = wp.clone(cables.body_q), worlds
        self._arms, self._arm_states = _Arms(model, worlds, self.dt), [model.state(), model.state()]

    def _move_hands(self) -> None:
        self._arms.step(*self._arm_states)
        self._arm_states.reverse()
        wp.launch(
            follow_hands,
            self._worlds,
            [self._arm_states[0].body_q[2:], self._start, len(self._start) // self._worlds],
            [self._states[0].body_q],
            device=self._start.device,
        )
