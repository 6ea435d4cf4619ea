"""Laying the rods of a knot, one after the other."""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.setup import disturb, prepare_deployment
from wrod.knots.tying_run import TyingRun, laying_of
from wrod.knots.workbench import Poses, Workbench
from wrod.patterns.curve import arc_length
from wrod.planning.tail import tail
from wrod.rods.rotation import carried, unit

# Length of the edges over the rod's radius: rods in contact want edges no longer than thick.
_EDGE = 2.0
# First stretch of a rod, which ends before the first crossing, and what is laid when it is let go
# [m].
_HOLD, _RELEASE = 0.05, 0.10


def lay(run: TyingRun, k: int) -> None:
    """Put the scene's rods on a new table, the next one hanging from the first hand, lay it, and
    let it go."""
    pattern, rod, trajectory = run.plans[k]
    edges = int(np.ceil(rod.length / (_EDGE * rod.radius)))
    arc = np.linspace(0.0, rod.length, edges + 1)
    rest = tail(pattern, rod, trajectory)
    undisturbed = prepare_deployment(
        pattern, rod, trajectory, arc, rest, hold=_HOLD, release=_RELEASE, speed=run.speed
    )
    setups = [disturb(undisturbed, laying_of(trial, k)) for trial in run.trials]
    position = np.stack([setup.position for setup in setups])
    director = np.stack([setup.director for setup in setups])
    director = _carried(position, director)
    if run.bench is not None:
        before = run.bench.batch
        lying = before.positions()
        for scene in range(len(run.trials)):
            position[scene] = _over(run, lying[scene], position[scene], arc, rod.radius)
        director = _carried(position, director[:, 0])
        position = np.concatenate([lying, position], axis=1)
        link = position[:, before.node_count] - position[:, before.node_count - 1]
        across = np.cross(link, [0.31, 0.59, 0.74])[:, None]
        director = np.concatenate([before.material_directors()[:, :, 0], across, director], axis=1)
        run.count_steps()
    run.arc.append(arc)
    run.begun = run.elapsed
    counts = [len(nodes) for nodes in run.arc]
    natural = [
        np.repeat([laying_of(trial, j).natural_curvature for j in range(k + 1)], counts)
        for trial in run.trials
    ]
    run.bench = bench = Workbench(
        [scene[: k + 1] for scene in run.true_rods],
        run.arc,
        position,
        director,
        run.friction,
        step=run.step,
        device=run.device,
        natural_curvature=np.array(natural),
    )
    schedule = [setup.schedule for setup in setups]
    last = bench.batch.node_count - 2
    keys = max(len(s.position) for s in schedule)
    table = np.stack([_padded(s.position, keys) for s in schedule])
    turns = np.stack([_padded(s.rotation, keys) for s in schedule])

    def follow(t: float) -> list[Poses]:
        key = min(round(t / KEY_INTERVAL), keys - 1)
        return [Poses(table[:, key], Rotation.from_quat(turns[:, key])), run.home[1]]

    nodes = bench.slices[-1]
    bench.held.hold_still(slice(nodes.start, nodes.start + schedule[0].held_nodes))
    start = follow(0.0)
    for scene in range(len(run.trials)):
        bench.held.grasp(scene, 0, last, start[0])
    run.closed[:, 0] = True
    run.run(min(s.release_time for s in schedule), follow)
    bench.held.hold_still(None)
    run.run(min(s.let_go_time for s in schedule), follow)
    for scene in range(len(run.trials)):
        bench.held.open(scene, 0)
    run.closed[:, 0] = False
    run.run(bench.time + 1.0, follow)
    run.elapsed += bench.time
    run.now = follow(bench.time)
    for scene, result in enumerate(run.results):
        laid = bench.positions()[-1][scene]
        target = pattern.sample(
            np.clip(arc - pattern.remainder_length, -pattern.remainder_length, pattern.length)
        )[0]
        on = arc <= pattern.length + pattern.remainder_length
        gap = np.linalg.norm((laid - target)[on, :2], axis=1)
        result.error.append(float(gap.mean()))


def _over(
    run: TyingRun, lying: np.ndarray, start: np.ndarray, arc: np.ndarray, radius: float
) -> np.ndarray:
    """(node, 3) the first shape of a rod, held over what already lies where it begins.

    Rods that were laid astray may lie there; the hand that holds the free end lays it over them.
    """
    raised = start.copy()
    for nodes, (_, rod, _) in zip(run.bench.slices, run.plans, strict=False):
        thick = rod.radius + radius
        below = _refined(lying[nodes])
        if cKDTree(below).query(_refined(start))[0].min() > 0.95 * thick:
            continue
        away = np.linalg.norm(raised[:, None, :2] - below[None, :, :2], axis=2)
        # As wide as rods that cross at a slant ask.
        need = below[:, 2] + 1.12 * thick * np.exp(-((away / (2.6 * thick)) ** 4))
        raised[:, 2] = np.maximum(raised[:, 2], np.where(away < 4 * thick, need, 0.0).max(axis=1))
    if (raised == start).all():
        return start
    # The detour takes length from the free end.
    along = arc_length(raised)
    along += arc[-1] - along[-1]
    return np.column_stack([np.interp(arc, along, raised[:, c]) for c in range(3)])


def _carried(position: np.ndarray, director: np.ndarray) -> np.ndarray:
    """(..., node - 1, 3) the first edge's director carried along the rods without twist."""
    tangents = unit(np.diff(position, axis=-2))
    along = np.sum(director * tangents[..., 0, :], axis=-1, keepdims=True)
    return carried(unit(director - along * tangents[..., 0, :]), tangents)


def _refined(line: np.ndarray) -> np.ndarray:
    """(4 n - 3, 3) points along a polyline (n, 3)."""
    at = np.arange(0, len(line) - 0.75, 0.25)
    return np.column_stack([np.interp(at, np.arange(len(line)), c) for c in line.T])


def _padded(values: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([values, np.repeat(values[-1:], count - len(values), axis=0)])
