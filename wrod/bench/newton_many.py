"""Scenes of `wrod bench newton --many`: many worlds, a graph of a step, piles."""

from collections.abc import Iterator
from functools import cache, partial

import numpy as np
import warp as wp

from wrod.bench.newton_held import CABLE, ArmedDer, ArmedVbd, HeldDer, HeldVbd
from wrod.bench.newton_piles import piles, seconds_of

_WARM_UP = 4  # steps that compile and record


def tip_after(held, seconds: float) -> tuple[np.ndarray, float]:
    """Where the first world's tip is after a while [m], and the seconds that all of them took."""
    steps = 2 * round(0.5 * seconds / held.dt)
    held.advance(_WARM_UP)
    took = seconds_of(lambda: held.advance(steps - _WARM_UP)) * steps / (steps - _WARM_UP)
    tips = held.tips()
    if not np.allclose(tips, tips[0], atol=1e-4):
        return np.full(3, np.nan), took
    return tips[0], took


@cache
def _fine_tip(device: str, edges: int, seconds: float, armed: bool) -> np.ndarray:
    held = (ArmedDer if armed else HeldDer)(1, 4 * edges, seconds / 1920, device)
    return tip_after(held, seconds)[0]


def worlds_of_cables(
    device: str,
    worlds: int,
    edges: int,
    seconds: float,
    iterations: tuple[int, ...] = (),
    armed: bool = False,
) -> Iterator[dict]:
    """Speed and error of the tip over the length after a while: of `SolverDER`, or of VBD with so
    many iterations. An arm carries the cable, or a body that is driven."""
    fine = _fine_tip(device, edges, seconds, armed)
    der, vbd = (ArmedDer, ArmedVbd) if armed else (HeldDer, HeldVbd)
    for rate, effort in [(600, i) for i in iterations] or [(60, None), (120, None)]:
        if effort is None:
            held = der(worlds, edges, 1.0 / rate, device)
        else:
            held = vbd(worlds, edges, 1.0 / rate, device, effort)
        tip, took = tip_after(held, seconds)
        yield {
            "scene": f"cable held by {'an arm' if armed else 'a driven body'}",
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
        go_on = held.advance if captured else held.launch
        go_on(_WARM_UP)
        took.append(1e3 * seconds_of(partial(go_on, steps)) / steps)
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
        return 1e3 * seconds_of(work) / steps

    held.launch(_WARM_UP)
    plain = timed(lambda: held.launch(steps))

    def measure_tips() -> None:
        arrays = [held.state.der.node_q, tips, loss]
        wp.launch(sum_of_squares, worlds, arrays, device=device)

    for _ in range(2):  # the first compiles
        tape = wp.Tape()
        with tape:
            taped = timed(lambda: held.launch(steps))
            measure_tips()
        back = timed(partial(tape.backward, loss))
        found = held.model.der.node_bending_stiffness.grad.numpy().copy().reshape(worlds, -1)
        tape.zero()
    captured = None
    if wp.get_device(device).is_cuda:
        with wp.ScopedCapture(device=device) as capture:
            tape = wp.Tape()
            with tape:
                held.launch(steps)
                measure_tips()
            tape.backward(loss)
        wp.capture_launch(capture.graph)
        captured = timed(partial(wp.capture_launch, capture.graph))
    yield {
        "scene": "steps on a tape", "worlds": worlds, "edges": edges, "steps": steps,
        "plain_ms": plain, "taped_ms": taped, "backward_ms": back,
        "both_in_a_graph_ms": captured,
        "gradients_differ": float(np.ptp(found, axis=0).max() / np.abs(found).max()),
    }  # fmt: skip


def measure(device: str, worlds: int, cables: int, edges: int) -> Iterator[dict]:
    """Rows of all scenes, as they come; a scene that fails yields its error."""
    seconds = 1.0
    scenes = [
        lambda: worlds_of_cables(device, worlds, edges, seconds),
        lambda: worlds_of_cables(device, worlds, edges, seconds, armed=True),
        lambda: graph_of_a_step(device, 1, edges),
        lambda: graph_of_a_step(device, worlds, edges),
        lambda: gradients_of_steps(device, worlds, edges),
        lambda: piles(device, cables, edges, 240),
        lambda: worlds_of_cables(device, worlds, edges, seconds, (10,)),
        lambda: worlds_of_cables(device, worlds, edges, seconds, (10,), armed=True),
    ]
    for scene in scenes:
        try:
            yield from scene()
        except Exception as error:
            yield {"scene": "failed", "error": f"{type(error).__name__}: {error}"}
