"""Free bodies of a Newton model that SolverDER moves, together with the rods that they hold or
touch."""

from collections.abc import Sequence

import numpy as np
from newton import Model

from wrod.errors import RodError
from wrod.kernels.stepping.bodies import Body
from wrod.newton_solver.body_contact import colliding_bodies
from wrod.newton_solver.holds import Holds, free_bodies


def choose_bodies(model: Model, holds: Holds, chosen: str | Sequence[int]) -> np.ndarray:
    """(body,) which bodies SolverDER moves: see its argument `bodies`.

    Raises:
        RodError: it can move none like that.
    """
    free = free_bodies(model)
    able = np.zeros_like(free)
    able[holds.bodies] = free[holds.bodies]
    if isinstance(chosen, str):
        if chosen not in ("free", "none"):
            raise RodError(f"bodies is {chosen!r}; use free, none or indices of bodies")
        return able & (chosen == "free")
    if model.body_count:
        near = np.isin(model.body_world.numpy(), model.der.rod_world.numpy())
        able |= near & colliding_bodies(model, free)
    for body in chosen:
        if not (0 <= body < len(able) and able[body]):
            raise RodError(
                f"bodies holds {body!r}, which is no free body that holds a rod, or may touch one "
                f"with a shape that collides; those are {np.flatnonzero(able).tolist()}"
            )
    return able & np.isin(np.arange(len(able)), chosen)


def find_owned(
    model: Model, rows: np.ndarray, holds: Holds, own: np.ndarray
) -> tuple[np.ndarray | None, list[dict[int, int]]]:
    """The bodies that move with the rods of each row.

    Returns:
        (row, slot) records of `wrod.kernels.stepping.bodies.Body`, or None if there are none; and
        the slots of the bodies by row.

    Raises:
        RodError: a body has no inertia.
    """
    slots = []
    worlds, loose = model.der.rod_world.numpy(), loose_bodies(model, holds, own)
    for rods in rows:
        bodies = {h.body for rod in rods for h in holds.of(int(rod)) if h.body >= 0}
        bodies |= {b for b, world in loose.items() if world == worlds[rods[0]]}
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
                    f"body {model.body_label[body]!r} is to move with rods and has mass but no "
                    "inertia; give it one, a shape with density, or make it kinematic"
                )
            out[row, slot] = (body, mass[body], com[body], tensor)
    return out, slots


def loose_bodies(model: Model, holds: Holds, own: np.ndarray) -> dict[int, int]:
    """The worlds of the bodies that move with rods and hold none."""
    loose = np.setdiff1d(np.flatnonzero(own), holds.bodies)
    worlds = model.body_world.numpy() if model.body_count else np.zeros(0, dtype=int)
    return {int(b): int(worlds[b]) for b in loose}
