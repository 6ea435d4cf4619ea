"""Scenes of `wrod bench newton --many`: many worlds, a graph of a step, piles."""

import time
from collections.abc import Iterator
from functools import cache, partial

import newton
import numpy as np
import warp as wp

from wrod.bench.cantilever import Cantilever, Start
from wrod.bench.cantilever_solvers import Vbd
from wrod.bench.newton_piles import piles
from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial

# A soft cable of the size that Newton's examples have, hung from a hand that goes to and fro.
CABLE = RodMaterial.from_youngs_modulus(5e6, radius=0.005, length=0.8, density=1150.0)
_AMPLITUDE, _RATE = 0.05, 2.0 * np.pi  # of the hand [m], [rad/s]
_WARM_UP = 4  # steps that compile and record
_VBD_WORLDS = 64  # at most: Newton's builder takes its time


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
        hand = world.add_body(is_kinematic=True)
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
        self._hands = _Hands(model, worlds, dt)
        self.last = (edges + 1) * (np.arange(worlds) + 1) - 1

    def step(self) -> None:
        """Two steps, there and back between the states: what a graph can hold."""
        for _ in range(2):
            self._hands.move(self._states[0])
            self._solver.step(self._states[0], self._states[1], None, None, self.dt)
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
        self._hands = _Hands(model, worlds, dt)

    def _step(self) -> None:
        self._hands.move(self._states[0])
        super()._step()


def tip_after(held, seconds: float) -> tuple[np.ndarray, float]:
    """Where the first world's tip is after a while [m], and the seconds that all of them took."""
    steps = 2 * round(0.5 * seconds / held.dt)
    held.advance(_WARM_UP)
    wp.synchronize()
    start = time.perf_counter()
    held.advance(steps - _WARM_UP)
    wp.synchronize()
    took = (time.perf_counter() - start) * steps / (steps - _WARM_UP)
    tips = held.tips()
    if not np.allclose(tips, tips[0], atol=1e-4):
        return np.full(3, np.nan), took
    return tips[0], took


@cache
def _fine_tip(device: str, edges: int, seconds: float) -> np.ndarray:
    return tip_after(HeldDer(1, 4 * edges, seconds / 1920, device), seconds)[0]


def worlds_of_cables(
    device: str, worlds: int, edges: int, seconds: float, iterations: tuple[int, ...] = ()
) -> Iterator[dict]:
    """Speed and error of the tip over the length after a while: of `SolverDER`, or of VBD with so
    many iterations."""
    fine = _fine_tip(device, edges, seconds)
    for rate, effort in [(600, i) for i in iterations] or [(60, None), (120, None)]:
        if effort is None:
            held = HeldDer(worlds, edges, 1.0 / rate, device)
        else:
            held = HeldVbd(worlds, edges, 1.0 / rate, device, effort)
        tip, took = tip_after(held, seconds)
        yield {
            "scene": "cable held by a driven body",
            "solver": "SolverDER" if effort is None else "SolverVBD", "worlds": worlds,
            "edges": edges, "steps_per_second": rate, "iterations": effort,
            "simulated_seconds_per_second": worlds * seconds / took,
            "tip_error_over_length": float(np.linalg.norm(tip - fine) / CABLE.length),
        }  # fmt: skip


def graph_of_a_step(device: str, worlds: int, edges: int, steps: int = 120) -> Iterator[dict]:
    """A step captured into a graph beside steps launched one by one."""
    tips, took = [], []
    for captured in (False, True):
        held = HeldDer(worlds, edges, 1.0 / 120, device)
        held.advance(_WARM_UP)
        graph = None
        if captured:
            with wp.ScopedCapture(device=device) as capture:
                held.step()
            graph = capture.graph
        wp.synchronize()
        start = time.perf_counter()
        for _ in range(steps // 2):
            held.step() if graph is None else wp.capture_launch(graph)
        wp.synchronize()
        took.append(1e3 * (time.perf_counter() - start) / steps)
        tips.append(held.tips())
    yield {
        "scene": "step in a graph", "worlds": worlds, "edges": edges, "steps": steps,
        "launched_ms": took[0], "captured_ms": took[1],
        "largest_difference_m": float(np.abs(tips[0] - tips[1]).max()),
    }  # fmt: skip


@wp.kernel
def sum_of_squares(q: wp.array[wp.vec3d], tip: wp.array[wp.int32], loss: wp.array[wp.float64]):
    w = wp.tid()
    wp.atomic_add(loss, 0, wp.length_sq(q[tip[w]]))


def gradients_of_steps(device: str, worlds: int, edges: int, steps: int = 40) -> Iterator[dict]:
    """Steps on a tape, and the way back through them, beside steps without one."""
    held = HeldDer(worlds, edges, 1.0 / 120, device, requires_grad=True)
    loss = wp.zeros(1, dtype=wp.float64, device=device, requires_grad=True)
    tips = wp.array(held.last, dtype=wp.int32, device=device)

    def timed(work) -> float:
        wp.synchronize()
        start = time.perf_counter()
        work()
        wp.synchronize()
        return 1e3 * (time.perf_counter() - start) / steps

    held.advance(_WARM_UP)
    plain = timed(lambda: held.advance(steps))
    for _ in range(2):  # the first compiles
        tape = wp.Tape()
        with tape:
            taped = timed(lambda: held.advance(steps))
            wp.launch(
                sum_of_squares,
                worlds,
                [held.state.der.node_q, tips, loss],
                device=device,
            )
        back = timed(partial(tape.backward, loss))
        found = held.model.der.node_bending_stiffness.grad.numpy().copy().reshape(worlds, -1)
        tape.zero()
    yield {
        "scene": "steps on a tape", "worlds": worlds, "edges": edges, "steps": steps,
        "plain_ms": plain, "taped_ms": taped, "backward_ms": back,
        "gradients_differ": float(np.ptp(found, axis=0).max() / np.abs(found).max()),
    }  # fmt: skip


def measure(
    device: str, worlds: int, cables: int, edges: int, seconds: float = 1.0
) -> Iterator[dict]:
    """Rows of all scenes, as they come; a scene that fails yields its error."""
    scenes = [
        lambda: worlds_of_cables(device, worlds, edges, seconds),
        lambda: graph_of_a_step(device, worlds, edges),
        lambda: gradients_of_steps(device, worlds, edges),
        lambda: piles(device, cables, edges, round(240 * seconds)),
        lambda: worlds_of_cables(device, min(worlds, _VBD_WORLDS), edges, seconds, (10,)),
    ]
    for scene in scenes:
        try:
            yield from scene()
        except Exception as error:
            yield {"scene": "failed", "error": f"{type(error).__name__}: {error}"}
