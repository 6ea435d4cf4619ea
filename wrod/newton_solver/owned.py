"""Free bodies of a Newton model that SolverDER moves, together with the rods that they hold."""

import numpy as np
from newton import Model

from wrod.errors import RodError
from wrod.kernels.stepping.bodies import Body
from wrod.newton_solver.holds import Holds


def find_owned(
    model: Model, rows: np.ndarray, holds: Holds, own: np.ndarray
) -> tuple[np.ndarray | None, list[dict[int, int]]]:
    """The bodies that move with the rods of each row.

    Returns:
        (row, slot) records of `wrod.kernels.stepping.bodies.Body`, or None if there are none; and
        the slots of the bodies by row.

    Raises:
        RodError: a body has no inertia, or hangs on rods of several worlds.
    """
    slots = []
    for rods in rows:
        bodies = {h.body for rod in rods for h in holds.of(int(rod)) if h.body >= 0}
        slots.append({b: k for k, b in enumerate(sorted(b for b in bodies if own[b]))})
    width = max(map(len, slots))
    if width == 0:
        return None, slots
    mass, com = model.body_mass.numpy(), model.body_com.numpy()
    inertia = model.body_inertia.numpy().astype(float)
    out = np.zeros((len(rows), width), dtype=Body.numpy_dtype())
    for row, by_body in enumerate(slots):
        for body, slot in by_body.items():
            tensor = 0.5 * (inertia[body] + inertia[body].T)
            if not np.linalg.eigvalsh(tensor)[0] > 0:
                raise RodError(
                    f"body {model.body_label[body]!r} holds a rod and has mass but no inertia; "
                    "give it one, a shape with density, or make it kinematic"
                )
            out[row, slot] = (body, mass[body], com[body], tensor)
    return out, slots
