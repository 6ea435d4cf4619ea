"""What friction alone does to a rod that lies exactly on its pattern: no controller lays better.

The rod is cut where the pattern ends, put down without any motion, and left to itself.
"""

import numpy as np

# Seconds that the rods are left to themselves.
_REST = 3.0


def put_down(
    courses: list[tuple], *, node_count: int, step: float, device: str
) -> list[tuple[np.ndarray, np.ndarray, bool, int]]:
    """Rods put down exactly, and where they lie after three seconds.

    Args:
        courses: (pattern with its remainder, rod, `Friction`) of each rod.
        node_count: nodes of every rod.
        step: largest time step [s].
        device: "cpu" or "cuda:0".

    Returns:
        For each rod its nodes' arc length (node,) and position (node, 3) [m], whether it diverged,
        and its time steps.
    """
    from wrod.deployment.left_alone import left_alone

    patterns, rods, friction = zip(*courses, strict=True)
    lengths = np.array([p.length + p.remainder_length for p in patterns])
    arc_length = np.linspace(0.0, lengths, node_count, axis=1)
    places, directors = [], []
    for pattern, rod, s in zip(patterns, rods, arc_length, strict=True):
        place, tangent, _ = pattern.sample(s - pattern.remainder_length)
        place[:, 2] = rod.radius
        places.append(place)
        directors.append(np.cross([0.0, 0.0, 1.0], tangent[0]))
    batch, dynamics = left_alone(
        rods, arc_length, np.stack(places), np.stack(directors), list(friction), device
    )
    end = dynamics.advance(_REST, step)
    return list(
        zip(arc_length, batch.positions(), end.diverged.tolist(), end.steps.tolist(), strict=True)
    )
