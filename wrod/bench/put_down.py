"""What friction alone does to a rod that lies exactly on its pattern.

The rod is cut where the pattern ends, put down without any motion where the robot has the pattern,
and left to itself. It differs from what is believed, and the robot stands elsewhere, as in the
trials of a plan; nothing shakes it.
"""

import numpy as np

from wrod.deployment.left_alone import left_alone
from wrod.rods.model import RodModel

# Seconds that the rods are left to themselves.
_REST = 3.0


def put_down(
    courses: list[tuple], *, node_count: int, step: float
) -> list[tuple[np.ndarray, np.ndarray, bool, int]]:
    """Rods put down exactly, and where they lie after three seconds.

    Args:
        courses: (pattern with its remainder, rod, `Friction`, `Disturbance`) of each rod.
        node_count: nodes of every rod.
        step: largest time step [s].

    Returns:
        For each rod its nodes' arc length (node,) and position (node, 3) [m], whether it diverged,
        and its time steps.
    """
    patterns, believed, friction, disturbances = zip(*courses, strict=True)
    lengths = np.array([p.length + p.remainder_length for p in patterns])
    arc_length = np.linspace(0.0, lengths, node_count, axis=1)
    places, directors = [], []
    rods = [
        RodModel.of(rod).stiffened((1.0 + how.lgb_error) ** 3).bent(how.natural_curvature)
        for rod, how in zip(believed, disturbances, strict=True)
    ]
    for pattern, rod, s, how in zip(patterns, rods, arc_length, disturbances, strict=True):
        place, tangent, _ = pattern.sample(s - pattern.remainder_length)
        place[:, 2] = rod.radius
        places.append(how.displaced(place, place[0]))
        directors.append(how.turned(np.cross([0.0, 0.0, 1.0], tangent[0])))
    batch, dynamics = left_alone(
        rods, arc_length, np.stack(places), np.stack(directors), list(friction), "cpu"
    )
    end = dynamics.advance(_REST, step)
    return list(
        zip(arc_length, batch.positions(), end.diverged.tolist(), end.steps.tolist(), strict=True)
    )
