"""Worlds of a cable that something holds: what `wrod.bench.newton_many` times."""

import newton
import numpy as np
import warp as wp

from wrod.bench.cantilever import Cantilever, Start
from wrod.bench.cantilever_solvers import Vbd
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


class _Hands:
    """What moves the first body of every world, of which each has `stride` bodies."""

    def __init__(self, model, worlds: int, dt: float):
        self._start, self._worlds, self._dt = wp.clone(model.body_q), worlds, dt
        self._stride = model.body_count // worlds
        self._time = wp.zeros(worlds, dtype=wp.float64, device=model.device)

    def move(self, state) -> None:
        wp.launch(
            move_hands,
            self._worlds,
            [wp.float64(self._dt), wp.float64(_AMPLITUDE), wp.float64(_RATE), self._stride]
            + [self._start, self._time],
            [state.body_q],
            device=self._start.device,
        )


class HeldDer:
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

    def _make_hands(self, worlds: int) -> None:
        self._hands = _Hands(self.model, worlds, self.dt)

    def _step(self) -> None:
        state, other = self._states
        self._hands.move(state)
        self._solver.step(state, other, None, None, self.dt)

    def step(self) -> None:
        """Two steps, there and back between the states: what a graph can hold."""
        for _ in range(2):
            self._step()
            self._states.reverse()

    def advance(self, steps: int) -> None:
        for _ in range(steps // 2):
            self.step()

    def tips(self) -> np.ndarray:
        if self._solver.diverged.any():
            return np.full((1, 3), np.nan)
        return self.state.der.node_q.numpy()[self.last]

    @property
    def state(self) -> newton.State:
        return self._states[0]


class HeldVbd(Vbd):
    """The same under Newton's own cable solver."""

    def __init__(self, worlds: int, edges: int, dt: float, device: str, iterations: int):
        super().__init__(
            Cantilever(CABLE, CABLE.length), edges, dt,
            Start(rods=worlds, gravity=False, damping=False), device, iterations,
        )  # fmt: skip
        model = self._solver.model
        model.gravity.assign(np.tile([CABLE.gravity, 0.0, 0.0], (len(model.gravity), 1)))
        self._make_hands(worlds)

    def _make_hands(self, worlds: int) -> None:
        self._hands = _Hands(self._solver.model, worlds, self.dt)

    def _move_hands(self) -> None:
        self._hands.move(self._states[0])

    def _step(self) -> None:
        self._move_hands()
        super()._step()
