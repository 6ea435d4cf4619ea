"""Piles of cables of `wrod bench newton`: wrod's and Newton's own, timed and looked into."""

import time
from collections.abc import Callable, Iterator

import newton
import numpy as np
import warp as wp
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wrod.newton_solver import SolverDER
from wrod.rods.material import RodMaterial
from wrod.solvers.dynamics import Dynamics

_FRAME = 1.0 / 60.0
_LAST = 30  # frames at the end of which the pile lies
_PATIENCE = 80.0  # seconds of a pile
# Of Newton's example `cable_pile`: radius, edges, their length, bending stiffness of a joint.
_RADIUS, _EDGES, _EDGE, _JOINT = 0.012, 40, 0.05, 100.0


class Pile:
    """Cables dropped onto each other and the ground, in layers at right angles.

    Attributes:
        model, state, solver: Newton's; `material` is the cables'.
        deepest: largest penetration seen between rods, over the radius.
    """

    radius, friction, frame = 0.003, (0.5, 0.3), _FRAME

    def __init__(self, cables: int = 6, edges: int = 20, device: str = "cpu"):
        length = 0.2
        arc = np.linspace(-0.5 * length, 0.5 * length, edges + 1)
        generator = np.random.default_rng(5)
        rods = []
        for k in range(cables):
            turn = 0.5 * np.pi * (k % 2) + generator.uniform(-0.2, 0.2)
            points = np.outer(arc, [np.cos(turn), np.sin(turn), 0.0])
            points += [*generator.uniform(-0.02, 0.02, 2), (2.0 + 3.0 * k) * self.radius]
            rods.append(points)
        self._build(rods, RodMaterial(self.radius, 0.04, length), device)

    def _build(self, rods: list, material: RodMaterial, device: str) -> None:
        builder = newton.ModelBuilder()
        SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = self.friction[0]
        builder.add_ground_plane()
        for points in rods:
            SolverDER.add_rod(builder, points, material, air_damping=0.5, internal_damping=0.005)
        self.material = material
        self.model = builder.finalize(device=device)
        self.solver = SolverDER(self.model, rod_contact=self.friction[1])
        self.state = self.model.state()
        self.deepest = 0.0

    def run(self, frames: int, rate: float = 60.0) -> float:
        """Go on; CPU seconds per simulated second."""
        start = time.process_time()
        for _ in range(frames):
            self.step(1.0 / rate)
        return (time.process_time() - start) * rate / frames

    def step(self, dt: float) -> None:
        self.solver.step(self.state, self.state, None, None, dt)
        contact = self.solver._groups[0].rod_contact
        self.deepest = max(self.deepest, float(contact.penetration.numpy().max()) / self.radius)

    def lines(self) -> list[np.ndarray]:
        """Nodes (node, 3) of every cable."""
        der, q = self.model.der, self.state.der.node_q.numpy()
        spans = zip(der.rod_first_node.numpy(), der.rod_node_count.numpy(), strict=True)
        return [q[first : first + count] for first, count in spans]


class LayeredPile(Pile):
    """Newton's example: layers of ten wavy, stiff cables of 2 m, each layer across the last."""

    radius, friction = _RADIUS, (1.0, 1.0)

    def __init__(self, cables: int = 40, device: str = "cpu"):
        length = _EDGES * _EDGE
        t = np.linspace(0.0, 1.0, _EDGES + 1)
        wave = 0.025 * length * np.sin(4.0 * np.pi * t)
        rods = []
        for k in range(cables):
            lane = (k % 10 - 4.5) * 0.15
            columns = [length * (t - 0.5), lane + wave]
            height = np.full_like(t, 0.3 + 3.0 * _RADIUS * (k // 10))
            rods.append(np.column_stack([*columns[:: -1 if k // 10 % 2 else 1], height]))
        young = 4.0 * _JOINT * _EDGE / (np.pi * _RADIUS**4)
        material = RodMaterial.from_youngs_modulus(
            young, radius=_RADIUS, length=length, density=1000.0
        )
        self._build(rods, material, device)


class VbdPile:
    """The same as Newton steps it: 10 steps a frame, 5 iterations of SolverVBD."""

    radius, frame = _RADIUS, _FRAME

    def __init__(self, cables: int = 40, device: str = "cpu"):
        from newton.examples.cable.example_cable_pile import Example
        from newton.viewer import ViewerNull

        with wp.ScopedDevice(device):
            self._example = Example(ViewerNull(num_frames=1), layers=cables // 10)

    def step(self, dt: float) -> None:
        self._example.step()

    def lines(self) -> list[np.ndarray]:
        pose = self._example.state_0.body_q.numpy().astype(float).reshape(-1, _EDGES, 7)
        ahead = Rotation.from_quat(pose[:, :, 3:].reshape(-1, 4)).apply([0.0, 0.0, 0.5 * _EDGE])
        ahead = ahead.reshape(*pose.shape[:2], 3)
        middle = pose[:, :, :3]
        return list(np.concatenate([middle[:, :1] - ahead[:, :1], middle + ahead], axis=1))


def deepest_of(lines: list[np.ndarray], radius: float) -> float:
    """Deepest penetration of cables into each other over their radius, by distances of segments."""
    p = np.concatenate([q[:-1] for q in lines])
    d = np.concatenate([np.diff(q, axis=0) for q in lines])
    owner = np.repeat(np.arange(len(lines)), [len(q) - 1 for q in lines])
    reach = 2.0 * radius + np.linalg.norm(d, axis=1).max()
    pairs = cKDTree(p + 0.5 * d).query_pairs(reach, output_type="ndarray")
    i, j = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]].T
    if not len(i):
        return 0.0

    def dot(a, b):
        return np.sum(a * b, axis=1)

    gap, a, b, c = p[i] - p[j], dot(d[i], d[i]), dot(d[i], d[j]), dot(d[j], d[j])
    e, f = dot(d[i], gap), dot(d[j], gap)
    s = np.clip((b * f - c * e) / np.maximum(a * c - b * b, 1e-12 * a * c), 0.0, 1.0)
    t = np.clip((b * s + f) / c, 0.0, 1.0)
    s = np.clip((b * t - e) / a, 0.0, 1.0)
    way = gap + s[:, None] * d[i] - t[:, None] * d[j]
    return float(max(0.0, 2.0 - np.linalg.norm(way, axis=1).min() / radius))


def seconds_of(work: Callable[[], None]) -> float:
    """What some work takes, and what it leaves a GPU to do."""
    wp.synchronize()
    start = time.perf_counter()
    work()
    wp.synchronize()
    return time.perf_counter() - start


def energy_of(dynamics: Dynamics) -> float:
    """All of a pile's energy [J]: what it gives back of that of contact is no gain."""
    return float(dynamics.energy()[0] + dynamics.contact_energy()[0])


def measure(heap, scene: str, solver: str, frames: int) -> dict:
    """Times of a pile's frames after the first two, and how deep its cables are in each other."""
    for _ in range(2):
        heap.step(heap.frame)  # compiles and records
    dynamics = heap.solver._groups[0].dynamics if isinstance(heap, Pile) else None
    times: list[float] = []
    deep, deepest, rise = 0.0, 0.0, 0.0
    last = scale = energy_of(dynamics) if dynamics else 0.0
    before = dynamics.iteration_count.numpy()[0] if dynamics else 0
    while len(times) < frames and sum(times) < _PATIENCE:
        times.append(seconds_of(lambda: heap.step(heap.frame)))
        deep = deepest_of(heap.lines(), heap.radius)
        deepest = max(deepest, deep)
        if dynamics:
            now = energy_of(dynamics)
            rise, last = max(rise, now - last), now
    row = {
        "scene": scene, "solver": solver, "frames": len(times),
        "seconds_per_simulated_second": float(np.mean(times) / heap.frame),
        "of_the_last_frames": float(np.mean(times[-_LAST:]) / heap.frame),
        "slowest_frame": float(np.max(times) / heap.frame),
        "deepest_over_radius": deepest, "at_the_end": deep,
    }  # fmt: skip
    if dynamics:
        rounds = int(dynamics.iteration_count.numpy()[0] - before)
        row |= {
            "touching_pairs": int(dynamics.system.pair_count.numpy()[0]),
            "ms_per_iteration": 1e3 * sum(times) / max(1, rounds), "iterations": rounds,
            "largest_rise_over_energy": float(rise / abs(scale)),
            "diverged": bool(heap.solver.diverged.any()),
        }  # fmt: skip
    return row


def piles(device: str, cables: int, edges: int, frames: int) -> Iterator[dict]:
    """Rows of a stack of cables, and of Newton's own pile by both solvers; Newton's example has
    whole layers of ten cables."""
    what = f"stack of {cables} cables of {edges} edges"
    yield measure(Pile(cables, edges, device=device), what, "SolverDER", frames)
    what = f"Newton's pile, {cables} cables of {_EDGES} edges"
    yield measure(LayeredPile(cables, device), what, "SolverDER", frames)
    if cables % 10 == 0:
        yield measure(VbdPile(cables, device), what, "SolverVBD", frames)
