"""A table with rods on it, and hands that grasp, carry and release them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.deployment.assembly import SINKING
from wrod.kernels.stepping import hands
from wrod.kernels.stepping.pace import Pace
from wrod.rods.batch import RodBatch
from wrod.rods.device import resolve_device
from wrod.rods.discretisation import end_to_end, mesh_arrays
from wrod.rods.material import RodMaterial
from wrod.rods.state import RodState
from wrod.solvers.compiling import compile_steps
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.prescribed import carry_edges
from wrod.solvers.readback import read
from wrod.solvers.rod_contact import RodContact

# Hands move smoothly; between these times straight [s].
TICK = 0.04


@dataclass(frozen=True)
class Poses:
    """Where one hand is in every scene: position (scene, 3) [m] and rotation (scene)."""

    position: np.ndarray
    rotation: Rotation


class Hands:
    """What the hands hold: at most one edge each (a `wrod.solvers.steps.Motion`), and their course
    from key to key.

    Attributes:
        holds: (scene, hand) the edge that each holds, or -1.
        course: of the hands, and how far each scene has come (`wrod.kernels.stepping.hands`).
        position, rotation: (scene, hand, key) of the held edges at the keys.
        felt: (scene, hand) force with which each hand held its edge against slipping out, at the
            last key [N]; a hand that presses it on the table holds it the better.
    """

    def __init__(self, batch: RodBatch, count: int):
        self.batch, self.count = batch, count
        scenes, device = batch.rod_count, batch.device
        shape = (scenes, count)
        self._movable = batch.free.numpy().copy()
        self._loose = wp.clone(batch.free)
        self.holds = wp.full(shape, -1, dtype=wp.int32, device=device)
        self._strength = wp.full(shape, wp.float64(np.inf), dtype=wp.float64, device=device)
        self.felt = wp.zeros(shape, dtype=wp.float64, device=device)
        # A hand's point is the middle of its edge.
        self._part = wp.full(shape, wp.float64(0.5), dtype=wp.float64, device=device)
        self.course = hands.Timetable()
        for name in ("last", "reached", "arrived"):
            setattr(self.course, name, wp.zeros(scenes, dtype=wp.int32, device=device))
        self._key = 0
        # Of the held edge in the hand.
        self.offset = np.zeros((scenes, count, 3))
        self._turn = np.tile([0.0, 0.0, 0.0, 1.0], (scenes, count, 1))

    @property
    def edge(self) -> np.ndarray:
        return self.holds.numpy().copy()

    def hold_still(self, nodes: slice | None) -> None:
        """Fix nodes, and the edges between them, in every scene; None lets them go."""
        loose = self._movable.copy()
        if nodes is not None:
            loose[:, 4 * nodes.start : 4 * nodes.stop] = 0
        self._loose.assign(loose)
        self._hold(self.edge)

    def edges(self) -> tuple[np.ndarray, Rotation]:
        """Middle (scene, edge, 3) and frame (scene * edge) of every edge now."""
        nodes = self.batch.positions()
        m1, m2 = np.moveaxis(self.batch.material_directors(), 2, 0)
        frame = np.stack([np.cross(m1, m2), m1, m2], axis=-1)
        middle = (nodes[:, 1:] + nodes[:, :-1]) / 2
        return middle, Rotation.from_matrix(frame.reshape(-1, 3, 3))

    def grasp(
        self, scene: int, hand: int, edge: int, poses: Poses, strength: float = np.inf
    ) -> None:
        """Close a hand, which is at its pose, on an edge where that is; what pulls it out with more
        than `strength` [N] has it."""
        middle, frame = self.edges()
        edges = middle.shape[1]
        back = poses.rotation[scene].inv()
        self.offset[scene, hand] = back.apply(middle[scene, edge] - poses.position[scene])
        self._turn[scene, hand] = (back * frame[scene * edges + edge]).as_quat()
        strengths = self._strength.numpy().copy()
        strengths[scene, hand] = strength
        self._strength.assign(strengths)
        self._change(scene, hand, edge)

    def open(self, scene: int, hand: int) -> None:
        self._change(scene, hand, -1)

    def _change(self, scene: int, hand: int, edge: int) -> None:
        held = self.edge
        held[scene, hand] = edge
        self._hold(held)

    def _hold(self, held: np.ndarray) -> None:
        free = self._loose.numpy().copy()
        for (scene, _), edge in np.ndenumerate(held):
            if edge >= 0:
                free[scene, 4 * edge : 4 * edge + 7] = 0
        self.batch.free.assign(free)
        self.holds.assign(held)

    def plan(self, times: Sequence[float], poses: Sequence[Sequence[Poses]]) -> bool:
        """Be told the poses of every hand at the first keys of a course of these times [s], after
        which only places are to change; whether what was recorded of an earlier course holds."""
        course, device, keys = self.course, self.batch.device, len(times)
        same = course.times is not None and course.times.shape[0] == keys
        if not same:
            course.times = wp.zeros(keys, dtype=wp.float64, device=device)
            shape = (*self.felt.shape, keys)
            self.position = wp.zeros(shape, dtype=wp.vec3d, device=device)
            self.rotation = wp.zeros(shape, dtype=wp.quatd, device=device)
        turns = [Rotation.from_quat(self._turn[:, h]) for h in range(self.count)]
        position, rotation = np.zeros((*self.felt.shape, keys, 3)), self.rotation.numpy().copy()
        for k, there in enumerate(poses):
            for h, pose in enumerate(there):
                position[:, h, k] = pose.position + pose.rotation.apply(self.offset[:, h])
                rotation[:, h, k] = (pose.rotation * turns[h]).as_quat()
        rotation[:, :, len(poses) :] = rotation[:, :, len(poses) - 1, None]
        course.times.assign(np.array(times))
        self.position.assign(position)
        self.rotation.assign(rotation)
        course.reached.zero_()
        course.last.zero_()
        self._key = 0
        return same

    def at_key(self) -> tuple[np.ndarray, np.ndarray]:
        """(scene, hand, 3) where what hands hold is at the key that each scene has reached [m], and
        (scene,) whether it waits there to go on."""
        reached, waits = self._waiting()
        places = read(self.position)[np.arange(len(reached)), :, reached]
        return places, waits

    def _waiting(self) -> tuple[np.ndarray, np.ndarray]:
        """(scene,) the key that each has reached, and whether it waits there: scenes that diverged
        come to no other, and those that have ended wait for none."""
        reached = read(self.course.reached)
        return reached, (reached == self._key) & (read(self.course.last) == self._key)

    def send(self, key: int, now: np.ndarray) -> np.ndarray:
        """Let scenes that wait go on to a key; (scene,) times of their next ones, or now [s]."""
        _, waits = self._waiting()
        last = read(self.course.last)
        self.course.last.assign(np.where(waits, key, last))
        following, self._key = read(self.course.times)[self._key + 1], key
        return np.where(waits, following, now)

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        poses = (self.holds, self._part, self.course.times, self.position, self.rotation)
        carry_edges(self.batch, poses, running, time, step, start)

    def arrive(self, reaction: wp.array, pace: Pace) -> None:
        """Feel what is held where scenes have come to a key, by the forces (scene, dof) that hold
        it, and let them go on to the next."""
        self.batch.launch(
            hands.arrive,
            self.batch.rod_count,
            [self._loose, self._strength, reaction, self.course, pace, self.holds],
            [self.felt, self.batch.free],
        )


@dataclass
class Workbench:
    """Scenes of the same rods on a table, one per trial.

    Args:
        rods: (scene, rod) materials.
        arc_length: (node,) rest arc length of each rod's nodes [m].
        position: (scene, node, 3) of all rods' nodes, one rod after the other [m].
        director: (scene, node - 1, 3) first material director of every edge, or (scene, 3).
        friction: of rods on the table, and of rods on rods.
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
    step: float = 0.01
    air_damping: float = 1.0
    tolerance: float = 1e-3
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
        compile_steps(resolve_device(self.device), "pairs", "hands")
        batch = RodBatch(self.position, director=self.director, device=self.device, **arrays)
        if cuts:
            batch.cut(cuts)
        self.batch = batch
        radius, weight = self._along("radius"), self._along("weight")
        load = np.array([rod[0].weight * rod[0].gravito_bending_length for rod in self.rods])
        table, between = self.friction
        self.table = Contact(batch, radius, weight / (SINKING * radius), table)
        self.touch = RodContact(batch, radius=radius[:, :-1], friction=between)
        self.held = Hands(batch, 2)
        self.dynamics = Dynamics(
            batch,
            scheme="euler",
            radius=radius.max(axis=1),
            air_damping=self.air_damping,
            contact=[self.table, self.touch],
            motion=self.held,
            force_scale=load,
            tolerance=self.tolerance,
            keeps_recording=True,
        )
        self.dynamics.max_iterations = 20
        self._feel: Callable[[], object] | None = None
        self.diverged = np.zeros(len(self.rods), dtype=bool)
        self.steps = np.zeros(len(self.rods), dtype=int)

    def _along(self, name: str) -> np.ndarray:
        """(scene, node) of a property of the rods."""
        counts = [s.stop - s.start for s in self.slices]
        rows = [
            np.repeat([float(getattr(rod, name)) for rod in scene], counts) for scene in self.rods
        ]
        return np.array(rows)

    def positions(self) -> list[np.ndarray]:
        """(scene, node, 3) of each rod [m]."""
        nodes = self.batch.positions()
        return [nodes[:, s].copy() for s in self.slices]

    def load(self) -> np.ndarray:
        """(scene, hand) force with which each hand held its rod at the last key [N]."""
        return read(self.held.felt)

    def run(self, until: float, poses: Callable[[float], Sequence[Poses]]) -> None:
        """Let time pass, the hands moving as `poses(time)` says; every scene at its own pace."""
        times = keys_until(self.time, until)
        if len(times) > 1:
            self.plan(times, [poses(t) for t in times])
            self.go_to(len(times) - 1)

    def plan(
        self,
        times: Sequence[float],
        poses: Sequence[Sequence[Poses]],
        feel: Callable[[], object] | None = None,
    ) -> None:
        """Tell the hands their course (`Hands.plan`); `feel` launches what those hands do that have
        just come to a key."""
        if not self.held.plan(times, poses) or feel is not self._feel:
            self.dynamics.forget_recording()
        self._feel = feel

    def go_to(self, key: int) -> None:
        """Let scenes go on to a key of their course."""
        held, dynamics = self.held, self.dynamics

        def arrive() -> None:
            held.arrive(dynamics.reaction, dynamics.pace)
            if self._feel is not None:
                self._feel()

        until = held.send(key, read(dynamics.time))
        progress = dynamics.advance(until, self.step, then=arrive)
        self.diverged, self.steps = progress.diverged, progress.steps
        self.time = float(read(held.course.times)[key])


def keys_until(now: float, until: float) -> list[float]:
    """Times at which hands that move from now on are told where to be [s]."""
    times = [now]
    while times[-1] < until - 1e-9:
        times.append(min(times[-1] + TICK, until))
    return times
