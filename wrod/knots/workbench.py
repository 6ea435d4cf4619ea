"""A table with rods on it, and hands that grasp, carry and release them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.rods.batch import RodBatch
from wrod.rods.device import resolve_device
from wrod.rods.discretisation import end_to_end, mesh_arrays
from wrod.rods.material import RodMaterial
from wrod.rods.state import RodState
from wrod.solvers import streams
from wrod.solvers.compiling import compile_steps
from wrod.solvers.contact import Contact, Friction
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.prescribed import carry_edges
from wrod.solvers.rod_contact import RodContact

# Hands move smoothly; between these times straight [s].
TICK = 0.04
_SINKING = 1.0 / 600.0


@dataclass(frozen=True)
class Poses:
    """Where one hand is in every scene: position (scene, 3) [m] and rotation (scene)."""

    position: np.ndarray
    rotation: Rotation


class Hands:
    """What the hands hold: at most one edge each (a `wrod.solvers.steps.Motion`)."""

    def __init__(self, batch: RodBatch, count: int):
        self.batch, self.count = batch, count
        scenes, device = batch.rod_count, batch.device
        self.edge = np.full((scenes, count), -1)
        self._movable = batch.free.numpy().copy()
        self._still = np.zeros_like(self._movable)
        shape = (scenes, count)
        self._edge = wp.array(self.edge, dtype=wp.int32, device=device)
        # A hand's point is the middle of its edge.
        self._part = wp.full(shape, wp.float64(0.5), dtype=wp.float64, device=device)
        self._position = wp.zeros((*shape, 2), dtype=wp.vec3d, device=device)
        self._rotation = wp.zeros((*shape, 2), dtype=wp.quatd, device=device)
        self._times = wp.array([0.0, 1.0], dtype=wp.float64, device=device)
        # Of the held edge in the hand.
        self._offset = np.zeros((scenes, count, 3))
        self._turn = np.tile([0.0, 0.0, 0.0, 1.0], (scenes, count, 1))
        self._turns = [Rotation.from_quat(self._turn[:, h]) for h in range(count)]
        # What the hands held where they were last told to go: they go on from there.
        self._last: tuple[list[Poses], tuple[np.ndarray, np.ndarray]] | None = None

    def hold_still(self, nodes: slice | None) -> None:
        """Fix nodes, and the edges between them, in every scene; None lets them go."""
        self._still[:] = 0
        if nodes is not None:
            self._still[:, 4 * nodes.start : 4 * nodes.stop] = 1
        self._release_degrees()

    def edges(self) -> tuple[np.ndarray, Rotation]:
        """Middle (scene, edge, 3) and frame (scene * edge) of every edge now."""
        nodes = self.batch.positions()
        m1, m2 = np.moveaxis(self.batch.material_directors(), 2, 0)
        frame = np.stack([np.cross(m1, m2), m1, m2], axis=-1)
        middle = (nodes[:, 1:] + nodes[:, :-1]) / 2
        return middle, Rotation.from_matrix(frame.reshape(-1, 3, 3))

    def grasp(self, scene: int, hand: int, edge: int, poses: Poses) -> None:
        """Close a hand, which is at its pose, on an edge where that is."""
        middle, frame = self.edges()
        edges = middle.shape[1]
        back = poses.rotation[scene].inv()
        self.edge[scene, hand] = edge
        self._offset[scene, hand] = back.apply(middle[scene, edge] - poses.position[scene])
        self._turn[scene, hand] = (back * frame[scene * edges + edge]).as_quat()
        self._turns[hand] = Rotation.from_quat(self._turn[:, hand])
        self._last = None
        self._release_degrees()

    def open(self, scene: int, hand: int) -> None:
        self.edge[scene, hand] = -1
        self._release_degrees()

    def _release_degrees(self) -> None:
        free = self._movable * (1 - self._still)
        for (scene, _), edge in np.ndenumerate(self.edge):
            if edge >= 0:
                free[scene, 4 * edge : 4 * edge + 7] = 0
        self.batch.free.assign(free.astype(np.int32))
        self._edge.assign(self.edge.astype(np.int32))

    def move(self, times: tuple[float, float], first: list[Poses], last: list[Poses]) -> None:
        """From one pose of every hand to another."""
        self._times.assign(times)
        known = self._last is not None and self._last[0] is first
        begin = self._last[1] if known else self._held(first)
        end = self._held(last)
        self._last = last, end
        for target, keys in zip(
            (self._position, self._rotation), zip(begin, end, strict=True), strict=True
        ):
            target.assign(np.ascontiguousarray(np.stack(keys, axis=2)))

    def _held(self, poses: list[Poses]) -> tuple[np.ndarray, np.ndarray]:
        """(scene, hand, 3) and quaternions (scene, hand, 4) of what hands hold at these poses."""
        positions = [p.position + p.rotation.apply(self._offset[:, h]) for h, p in enumerate(poses)]
        turns = [(p.rotation * self._turns[h]).as_quat() for h, p in enumerate(poses)]
        return np.stack(positions, axis=1), np.stack(turns, axis=1)

    def load(self, reaction: np.ndarray) -> np.ndarray:
        """(scene, hand) force with which each hand holds its edge against slipping out [N]; a hand
        that presses it on the table holds it the better. `reaction` (scene, dof) holds it [N]."""
        out = np.zeros(self.edge.shape)
        for (scene, hand), e in np.ndenumerate(self.edge):
            if e >= 0:
                g = reaction[scene, 4 * e : 4 * e + 7]
                x, y, z = g[:3] + g[4:7]
                out[scene, hand] = np.linalg.norm([x, y, max(z, 0.0)])
        return out

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        poses = (self._edge, self._part, self._times, self._position, self._rotation)
        carry_edges(self.batch, poses, running, time, step, start)


@dataclass
class Workbench:
    """Scenes of the same rods on a table, one per trial.

    Args:
        rods: (scene, rod) materials.
        arc_length: (node,) rest arc length of each rod's nodes [m].
        position: (scene, node, 3) of all rods' nodes, one rod after the other [m].
        director: (scene, node - 1, 3) first material director of every edge, or (scene, 3).
        friction: of rods on the table, and of rods on rods.
        hands: how many there are.
        step: largest time step [s].
        natural_curvature: (scene, node) curvature at rest, towards the first director [1/m].

    Attributes:
        time: now [s].
    """

    rods: Sequence[Sequence[RodMaterial]]
    arc_length: Sequence[np.ndarray]
    position: np.ndarray
    director: np.ndarray
    friction: tuple[Friction, Friction]
    hands: int = 2
    step: float = 0.01
    air_damping: float = 1.0
    tolerance: float = 1e-4
    device: str = "cpu"
    natural_curvature: np.ndarray | float = 0.0
    time: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        counts = [len(arc) for arc in self.arc_length]
        ends = np.cumsum(counts)
        self.slices = [slice(e - n, e) for n, e in zip(counts, ends, strict=True)]
        cuts = [int(e) - 1 for e in ends[:-1]]
        lines = [
            mesh_arrays([scene[k] for scene in self.rods], arc)
            for k, arc in enumerate(self.arc_length)
        ]
        arrays = end_to_end(lines)
        arrays["natural_curvature"][:, :, 0] += self.natural_curvature
        compile_steps(resolve_device(self.device), coupled=True)
        batch = RodBatch(self.position, director=self.director, device=self.device, **arrays)
        if cuts:
            batch.cut(cuts)
        self.batch = batch
        radius, weight = self._along("radius"), self._along("weight")
        load = np.array([rod[0].weight * rod[0].gravito_bending_length for rod in self.rods])
        table, between = self.friction
        self.table = Contact(batch, radius, weight / (_SINKING * radius), table)
        self.touch = RodContact(batch, radius=radius[:, :-1], friction=between)
        self.held = Hands(batch, self.hands)
        self.dynamics = Dynamics(
            batch,
            scheme="euler",
            radius=radius.max(axis=1),
            air_damping=self.air_damping,
            contact=[self.table, self.touch],
            motion=self.held,
            force_scale=load,
            tolerance=self.tolerance,
            max_iterations=20,
            keeps_recording=True,
        )
        self.diverged = np.zeros(len(self.rods), dtype=bool)
        self.steps = np.zeros(len(self.rods), dtype=int)

    def _along(self, name: str) -> np.ndarray:
        """(scene, node) of a property of the rods."""
        counts = [s.stop - s.start for s in self.slices]
        rows = [
            np.repeat([float(getattr(rod, name)) for rod in scene], counts) for scene in self.rods
        ]
        return np.array(rows)

    def handle_roughly(self) -> None:
        """From now on forces are those of hands and knots, a hundred times those of laying: solve
        steps ten times less closely."""
        self.dynamics.tolerance = 10.0 * self.tolerance

    def positions(self) -> list[np.ndarray]:
        """(scene, node, 3) of each rod [m]."""
        nodes = self.batch.positions()
        return [nodes[:, s].copy() for s in self.slices]

    def load(self) -> np.ndarray:
        """(scene, hand) force with which each hand holds its rod after the last step [N]."""
        return self.held.load(streams.read(self.dynamics.reaction))

    def run(
        self,
        until: float,
        poses: Callable[[float], list[Poses]],
        after_tick: Callable[[], None] | None = None,
    ) -> None:
        """Let time pass, the hands moving as `poses(time)` says."""
        first = poses(self.time)
        while self.time < until - 1e-9:
            now = min(self.time + TICK, until)
            last = poses(now)
            self.held.move((self.time, now), first, last)
            progress = self.dynamics.advance(now, self.step)
            self.diverged, self.steps = progress.diverged, progress.steps
            self.time, first = now, last
            if after_tick is not None:
                after_tick()
