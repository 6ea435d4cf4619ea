"""Scenes of `wrod bench newton --many`: worlds of a cable that an arm holds."""

import newton
import numpy as np
import warp as wp

from wrod.bench.newton_held import CABLE, HeldDer, HeldVbd

# Two links of this length [m] and mass [kg], and a hand; control and armature of the joints.
_REACH, _MASS, _HAND = 0.3, 0.5, 0.1
_STIFFNESS, _DAMPING, _ARMATURE = (900.0, 400.0, 60.0), (40.0, 16.0, 3.0), (0.2, 0.1, 0.05)
_SWING, _RATE = 0.08, 2.0 * np.pi  # of the shoulder's target [rad], [rad/s]
_STEP = 1.0 / 240.0  # longest of the arm's own steps [s]: Featherstone's are explicit


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
