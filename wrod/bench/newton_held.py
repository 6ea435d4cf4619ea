"""Worlds of a cable that something holds: what `wrod.bench.newton_many` times."""

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

# A soft cable of the size that Newton's examples have, hung from a hand that goes to and fro.
CABLE = RodMaterial.from_youngs_modulus(5e6, radius=0.005, length=0.8, density=1150.0)
_AMPLITUDE, _RATE = 0.05, 2.0 * np.pi  # of the hand [m], [rad/s]


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
