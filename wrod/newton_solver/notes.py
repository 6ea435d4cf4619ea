"""What a solver says of scenes that are set up otherwise than they seem meant to be."""

import warnings

import newton
import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.errors import RodError, WrodWarning
from wrod.newton_solver.holds import Holds


def _say(text: str, within: int = 0) -> None:
    # Of the line that called the solver: through `arguments.checked`, `step`, and this module.
    warnings.warn(text, WrodWarning, stacklevel=5 + within)


def _named(model: newton.Model, bodies) -> str:
    return ", ".join(repr(model.body_label[b]) for b in bodies[:3])


def nothing_holds(model: newton.Model, bodies) -> None:
    """Bodies that the solver moves would touch something, and it was given no contacts."""
    _say(
        f"this solver moves bodies with shapes ({_named(model, bodies)}) and was given no "
        "contacts: they fall through everything but rods. Give step the contacts of a "
        "newton.CollisionPipeline, or make them shapes without collision"
    )


def rods_of_long_ago() -> None:
    """Another solver has stepped into a state that the rods were not carried over to."""
    _say(
        "the rods of state_in are not those of the last step, which went into another "
        "state; other solvers do not carry rods over. Where one has written bodies into "
        "`other`, call step(state, other, control, contacts, dt, moved=other)"
    )


def begins_elsewhere(model: newton.Model, holds: Holds, rods: wp.array, poses: wp.array) -> None:
    """Look, in the memory of a CPU, whether rods begin in the ground, or farther than an edge from
    links that hold them: those are where their joints have them only once kinematics were
    evaluated."""
    _begins_beneath(model, rods.numpy())
    if not model.body_count:
        return
    der, nodes, bodies = model.der, rods.numpy(), poses.numpy().astype(float)
    first, longest = der.rod_first_node.numpy(), der.edge_rest_length.numpy().max()
    jointed = model.joint_type.numpy() != int(newton.JointType.FREE)
    links = set(model.joint_child.numpy()[jointed].tolist())  # what others move may jump
    for rod in range(len(first)):
        for h in holds.of(rod):
            if h.body not in links:
                continue
            pose = bodies[h.body]
            place = pose[:3] + Rotation.from_quat(pose[3:]).apply(h.position)
            gap = float(np.linalg.norm(place - nodes[first[rod] + h.node]))
            if gap > longest:
                _say(
                    f"rod {rod} begins {gap:.3g} m from where body {model.body_label[h.body]!r} "
                    "holds it: as model.body_q had it when the solver was made. Bring that to "
                    "where joints have it before: newton.eval_fk(model, model.joint_q, "
                    "model.joint_qd, model)"
                )
                return


def _begins_beneath(model: newton.Model, nodes: np.ndarray) -> None:
    """Planes push at once what solids let out slowly: it is thrown off as by a spring."""
    if not model.shape_count:
        return
    kinds, flags, sizes = (getattr(model, f"shape_{n}").numpy() for n in ("type", "flags", "scale"))
    ground = (kinds == newton.GeoType.PLANE) & ~sizes[:, :2].any(axis=1)
    ground &= (flags & int(newton.ShapeFlags.COLLIDE_SHAPES) != 0) & (model.shape_body.numpy() < 0)
    poses, worlds = model.shape_transform.numpy().astype(float), model.shape_world.numpy()
    count, radius = model.der.rod_node_count.numpy(), model.der.rod_radius.numpy()
    radius, world = np.repeat(radius, count), np.repeat(model.der.rod_world.numpy(), count)
    for k in np.flatnonzero(ground):
        up = Rotation.from_quat(poses[k, 3:]).apply([0.0, 0.0, 1.0])
        depth = radius - (nodes - poses[k, :3]) @ up
        depth[(worlds[k] >= 0) & (world != worlds[k])] = 0.0
        if (depth > 0.5 * radius).any():
            rod = int(np.repeat(np.arange(len(count)), count)[np.argmax(depth)])
            _say(
                f"rod {rod} begins {depth.max():.3g} m deep in plane {model.shape_label[k]!r}, "
                "which throws it out; begin a radius above it",
                within=1,
            )


def nobody_feels(model: newton.Model, bodies) -> None:
    """Rods pull at bodies that another solver moves."""
    _say(
        f"rods pull at bodies that another solver moves ({_named(model, bodies)}), which does not "
        "feel them; call add_body_forces(state) on the state that it steps from"
    )


def shaken(model: newton.Model, longest: dict[int, float], dt: float) -> None:
    """Stiff contact gives a light body of another solver its load a step late."""
    body = min(longest, key=lambda b: longest[b])
    _say(
        f"body {model.body_label[body]!r}, which another solver moves, is pressed by rods, and "
        f"gets their load a step late: steps of {dt:.3g} s shake it if several edges touch it. "
        f"Take steps below {longest[body]:.2g} s, a smaller contact_stiffness, or let SolverDER "
        "move it"
    )


def refuse_what_is_no_number(
    model: newton.Model, rods: newton.State, bodies: newton.State, moves_bodies: bool
) -> None:
    """Look through the states of a step, in the memory of a CPU: `rods`, and `bodies` at its end.

    Raises:
        RodError: a number that the step would use is not finite.
    """
    of_rods = [("node", n) for n in ("node_q", "node_qd")]
    of_rods += [("edge", n) for n in ("edge_director", "edge_spin")]
    for kind, name in of_rods:
        values = getattr(rods.der, name).numpy()
        if not np.isfinite(values).all():
            at = int(np.argwhere(~np.isfinite(values))[0, 0])
            first = getattr(model.der, f"rod_first_{kind}").numpy()
            rod = int(np.flatnonzero(first <= at)[np.argmax(first[first <= at])])
            raise RodError(
                f"{name} of {kind} {at - int(first[rod])} of rod {rod} is not finite in the state; "
                "give finite numbers, or reset(state)"
            )
    if not model.body_count:
        return
    given = [("body_q", bodies)]
    if moves_bodies:
        given += [("body_q", rods), ("body_qd", rods), ("body_f", rods)]
    for name, state in given:
        values = getattr(state, name).numpy()
        if not np.isfinite(values).all():
            at = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise RodError(
                f"{name} of body {model.body_label[at]!r} is not finite in the state; give "
                "finite numbers"
            )
