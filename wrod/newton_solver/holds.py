"""What holds the ends of a model's rods, in the frames of the bodies that do."""

from __future__ import annotations

import newton
import numpy as np
from scipy.spatial.transform import Rotation

from wrod.kernels.stepping.carrying import Hold
from wrod.newton_solver.attributes import FREE


def find_holds(model: newton.Model) -> np.ndarray:
    """(rod, 2) records of `wrod.kernels.stepping.carrying.Hold`, start and end of every rod."""
    der = model.der
    first_node, first_edge, count = (
        getattr(der, f"rod_{name}").numpy() for name in ("first_node", "first_edge", "node_count")
    )
    q, director = der.node_q.numpy(), der.edge_director.numpy()
    bodies = model.body_q.numpy().astype(float)
    out = np.zeros((len(count), 2), dtype=Hold.numpy_dtype())
    out["rotation"][..., 3] = 1.0
    for side, name in enumerate(("start", "end")):
        kinds = getattr(der, f"rod_{name}_hold").numpy()
        carriers = getattr(der, f"rod_{name}_body").numpy()
        for r in np.flatnonzero(kinds != FREE):
            body = carriers[r]
            edge = side * (count[r] - 2)
            tangent = q[first_node[r] + edge + 1] - q[first_node[r] + edge]
            tangent = tangent / np.linalg.norm(tangent)
            side_way = director[first_edge[r] + edge]
            frame = np.column_stack([tangent, side_way, np.cross(tangent, side_way)])
            place = q[first_node[r] + side * (count[r] - 1)]
            turn = Rotation.from_matrix(frame)
            if body >= 0:
                carrier = Rotation.from_quat(bodies[body, 3:])
                place = carrier.inv().apply(place - bodies[body, :3])
                turn = carrier.inv() * turn
            out[r, side] = (kinds[r], body, place, turn.as_quat())
    return out
