"""Deployments in another engine: MuJoCo lays a chain of rigid segments, joined by springs.

Nothing is shared with wrod's own simulation but the plan and the first shape: the chain does not
stretch, its contacts are MuJoCo's soft ones with elliptic Coulomb cones, and steps are explicit in
the springs. It is what a plan made through wrod's simulation is checked against.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.simulate import Trial, prepare_trials, with_remainder_of
from wrod.errors import RodError

# Time over which springs and contacts are damped, in time steps: springs are explicit.
_SPRING_DAMPING, _CONTACT_TIME = 2.0, 3.0
# A laid rod of silicone or rope does not roll: rolling friction beyond what sliding asks of it.
_ROLLING = 2.0


def lay_in_mujoco(
    trial: Trial,
    *,
    hold: float = 0.05,
    release: float | None = None,
    speed: float = 0.04,
    segment: float = 0.005,
    step: float = 0.002,
) -> tuple[np.ndarray, np.ndarray]:
    """Lay one rod until the end of its pattern, the grip still holding.

    Args:
        trial: on the plane table, without fixtures; its disturbance counts as in wrod, natural
            curvature left out.
        hold, release, speed: as in `simulate_deployments`.
        segment: length of a rigid segment [m]; a step costs as its inverse cubed.
        step: time step [s].

    Returns:
        Arc length of the ends of the segments (n + 1,) and their positions (n + 1, 3) [m], at the
        height of the pattern's plane.

    Raises:
        RodError: MuJoCo is not installed, or the simulation blew up.
    """
    try:
        import mujoco
    except ImportError:
        raise RodError("the other engine is MuJoCo; install wrod[peers]") from None
    (setup,) = prepare_trials(
        [trial], hold, hold if release is None else release, speed, segment, None
    )
    rod, schedule = trial.rod, setup.schedule
    count = round(rod.length / segment)
    s = np.linspace(0.0, rod.length, count + 1)
    shape = CubicSpline(setup.arc_length, setup.position)(s)
    frames = _frames(np.diff(shape, axis=0), setup.director)
    held = int(np.searchsorted(s, setup.arc_length[schedule.held_nodes - 1] + 1e-6)) - 1
    model = mujoco.MjModel.from_xml_string(_model(trial, rod.length / count, count, held, step))
    data = mujoco.MjData(model)
    data.qpos[:3] = shape[0]
    data.qpos[3:7] = _wxyz(Rotation.from_matrix(frames[0]))
    bends = Rotation.from_matrix(np.swapaxes(frames[:-1], 1, 2) @ frames[1:])
    data.qpos[7:] = _wxyz(bends).ravel()
    mujoco.mj_kinematics(model, data)
    for k in range(held):
        # Held segments keep the poses that they have now.
        data.mocap_pos[1 + k] = data.xpos[2 + held + k]
        data.mocap_quat[1 + k] = data.xquat[2 + held + k]
    keys = KEY_INTERVAL * np.arange(len(schedule.position))
    position = CubicSpline(keys, schedule.position)
    quaternion = CubicSpline(keys, schedule.rotation)
    for _ in range(int(np.ceil(setup.measure_time / step))):
        t = data.time + step
        data.mocap_pos[0] = position(min(t, keys[-1]))
        x, y, z, w = quaternion(min(t, keys[-1]))
        data.mocap_quat[0] = np.array([w, x, y, z]) / np.sqrt(w * w + x * x + y * y + z * z)
        if t > schedule.release_time:
            data.eq_active[1:] = 0
        mujoco.mj_step(model, data)
    first = 2 + held
    ends = data.xpos[first:] + 0.0
    turn = data.xmat[-1].reshape(3, 3)
    ends = np.concatenate([ends, ends[-1:] + rod.length / count * turn[:, 0]])
    if not np.isfinite(ends).all() or np.abs(ends).max() > 10.0:
        raise RodError("MuJoCo's chain blew up")
    pattern = with_remainder_of(trial.pattern, trial.trajectory)
    return s, ends - [0.0, 0.0, rod.radius - pattern.sample(0.0)[0][0, 2]]


def _frames(edges: np.ndarray, director: np.ndarray) -> np.ndarray:
    """(n, 3, 3) frames without twist, x along the edges."""
    x = edges / np.linalg.norm(edges, axis=1)[:, None]
    side = director - (director @ x[0]) * x[0]
    out = []
    before = x[0]
    for tangent in x:
        axis = np.cross(before, tangent)
        side = side + np.cross(axis, side) + (axis @ side) / (1.0 + before @ tangent) * axis
        side = side - (side @ tangent) * tangent
        side = side / np.linalg.norm(side)
        out.append(np.column_stack([tangent, side, np.cross(tangent, side)]))
        before = tangent
    return np.array(out)


def _wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def _model(trial: Trial, length: float, count: int, held: int, step: float) -> str:
    """MJCF of the chain along x, the table, a hand, and what holds the first segments."""
    rod, mu = trial.rod, trial.friction.static
    lgb = rod.gravito_bending_length * (1.0 + trial.disturbance.lgb_error)
    stiffness = rod.bending_stiffness * (lgb / rod.gravito_bending_length) ** 3 / length
    mass = rod.weight / rod.gravity * length
    spring = f'stiffness="{stiffness}" damping="{stiffness * _SPRING_DAMPING * step}"'
    # A rod's own inertia about its axis, and a thin rod's across it.
    across, along = mass * length**2 / 12.0, 0.5 * mass * rod.radius**2
    inertia = (
        f'<inertial pos="{0.5 * length} 0 0" mass="{mass}" '
        f'diaginertia="{along} {across + 0.5 * along} {across + 0.5 * along}"/>'
    )
    ball = f'<geom type="sphere" size="{rod.radius}" pos="{0.5 * length} 0 0"/>'
    chain = f'<body name="s0"><freejoint/>{inertia}{ball}'
    for k in range(1, count):
        chain += (
            f'<body name="s{k}" pos="{length} 0 0"><joint type="ball" {spring}/>{inertia}{ball}'
        )
    chain += "</body>" * count
    hands = '<body name="hand" mocap="true"/>' + "".join(
        f'<body name="h{k}" mocap="true"/>' for k in range(held)
    )
    weld = f'solref="{2.0 * step} 1"'
    welds = (
        f'<weld body1="hand" body2="s{count - 1}" relpose="{-length} 0 0 1 0 0 0" {weld}/>'
    ) + "".join(
        f'<weld body1="h{k}" body2="s{k}" relpose="0 0 0 1 0 0 0" {weld}/>' for k in range(held)
    )
    rolling = _ROLLING * max(mu, 0.1) * rod.radius
    return f"""<mujoco>
  <option timestep="{step}" integrator="implicitfast" cone="elliptic" impratio="10"
    gravity="0 0 {-rod.gravity}" iterations="30" tolerance="1e-10"/>
  <size memory="200M"/>
  <default><geom condim="6" friction="{mu} {rolling} {rolling}" priority="0" contype="1"
    conaffinity="2" solref="{_CONTACT_TIME * step} 1" solimp="0.95 0.99 0.0001"/></default>
  <worldbody>
    <geom type="plane" size="5 5 1" contype="2" conaffinity="1"/>
    {hands}{chain}
  </worldbody>
  <equality>{welds}</equality>
</mujoco>"""
