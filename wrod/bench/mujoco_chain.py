"""Rods in another engine: MuJoCo lays a chain of rigid segments that springs keep straight.

Nothing is shared with wrod's own simulation but the plan and the first shape: the chain does not
stretch, its contacts are MuJoCo's soft ones with elliptic Coulomb cones, and its coordinates are
angles between segments. It is what a plan made through wrod's simulation is checked against; its
parameters were set by a cantilever, a folded rod and a slope (`tests/peers/test_mujoco_chain.py`),
not by what it lays.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.deployment.assembly import INTERNAL_DAMPING
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.setup import Disturbance, Setup, blend
from wrod.deployment.simulate import Trial, prepare_trials
from wrod.errors import RodError, needed_extras
from wrod.patterns.pattern import Pattern
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.rotation import carried, unit

# Time constant of the contacts, in time steps.
_CONTACT_TIME = 2.0
# That of the welds; a critically damped one follows a moving body twice as late.
_WELD_TIME = 2.0
# Drag per mass and velocity [1/s], as wrod assumes for a rod that says nothing.
_AIR = 1.0
# Radius of the spheres that touch the table, over the rod's: contact at the centreline does not
# let what lies roll, which rods of silicone and rope do not.
_TOUCH = 1e-3
# Of a rod that is put down: length of a segment [m], time that it lies [s].
_SEGMENT, _LYING = 0.008, 3.0


@needed_extras()
def require_mujoco():
    """The package.

    Raises:
        MissingExtraError: it is not installed.
    """
    import mujoco

    return mujoco


@dataclass
class MujocoChain:
    """A rod in MuJoCo.

    Attributes:
        model, data: MuJoCo's.
        length: (n,) of the segments [m].
        body: (n,) numbers of the segments' bodies.
        root: the segment that all others hang on.
    """

    model: Any
    data: Any
    length: np.ndarray
    body: np.ndarray
    root: int

    def nodes(self) -> np.ndarray:
        """(n + 1, 3) ends of the segments [m]."""
        origin = self.data.xpos[self.body]
        along = self.data.xmat[self.body].reshape(-1, 3, 3)[:, :, 0] * self.length[:, None]
        start = origin.copy()
        start[: self.root] -= along[: self.root]
        return np.concatenate([start, start[-1:] + along[-1:]])

    def step(self, count: int = 1, air: float = _AIR) -> None:
        """Time steps, in air that slows every segment by `air` [1/s].

        Raises:
            RodError: the simulation blew up.
        """
        mujoco = require_mujoco()
        for _ in range(count):
            self._drag(air)
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        if not np.isfinite(self.data.qpos).all() or np.abs(self.data.qvel).max() > 1e4:
            raise RodError("MuJoCo's chain blew up; give a smaller step")

    def _drag(self, rate: float) -> None:
        model, data = self.model, self.data
        speed = data.cvel[:, 3:] + np.cross(
            data.cvel[:, :3], data.xipos - data.subtree_com[model.body_rootid]
        )
        data.xfrc_applied[:, :3] = -rate * model.body_mass[:, None] * speed


def chain(
    nodes: np.ndarray,
    director: np.ndarray,
    *,
    stiffness: float,
    weight: float,
    radius: float,
    friction: float,
    natural_curvature: float = 0.0,
    held: int = 0,
    hand: bool = True,
    step: float = 0.004,
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
    lengths: np.ndarray | None = None,
) -> MujocoChain:
    """A rod along nodes (n + 1, 3) [m], straight at rest, above a table at z = 0.

    Args:
        nodes: its first shape.
        director: (3,) across the first segment.
        stiffness: in bending, and in twisting [N m^2].
        weight: per length [N/m].
        radius: [m].
        friction: coefficient of table and rod.
        natural_curvature: at rest, about the second director of the frames without twist [1/m].
        held: so many first segments are held where they are, each by a weld.
        hand: whether a mocap body ("hand") holds the last segment by its end.
        step: [s].
        gravity: [m/s^2]; a slope is a gravity that leans.
        lengths: (n,) of the segments [m]; default: of `nodes`.

    Raises:
        MissingExtraError: MuJoCo is not installed.
    """
    mujoco = require_mujoco()
    edges = np.diff(nodes, axis=0)
    length = np.linalg.norm(edges, axis=1) if lengths is None else lengths
    count = len(length)
    tangent = unit(edges)
    side = carried(unit(director - (director @ tangent[0]) * tangent[0]), tangent)
    frames = np.stack([tangent, side, np.cross(tangent, side)], axis=2)
    mass = weight / float(np.linalg.norm(gravity)) * length
    text = _model(length, mass, stiffness, radius, friction, held, hand, step, gravity)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    root = count // 2
    bends = Rotation.from_matrix(np.swapaxes(frames[:-1], 1, 2) @ frames[1:])
    # The rod of the first shape may be stretched, and the chain begins at its first node.
    data.qpos[:3] = nodes[0] + length[:root] @ frames[:root, :, 0]
    data.qpos[3:7] = _wxyz(Rotation.from_matrix(frames[root]))
    data.qpos[7:] = _outward(bends, root)
    angle = natural_curvature * 0.5 * (length[1:] + length[:-1])
    model.qpos_spring[7:] = _outward(Rotation.from_euler("z", angle[:, None]), root)
    mujoco.mj_forward(model, data)
    names = [model.body(f"s{k}").id for k in range(count)]
    one = MujocoChain(model, data, length, np.array(names), root)
    for k in range(held):
        data.mocap_pos[int(hand) + k] = data.xpos[names[k]]
        data.mocap_quat[int(hand) + k] = data.xquat[names[k]]
    if hand:
        data.mocap_pos[0], data.mocap_quat[0] = one.nodes()[-1], data.xquat[names[-1]]
    return one


def lay_in_mujoco(
    trial: Trial,
    *,
    hold: float = 0.05,
    release: float | None = None,
    speed: float = 0.04,
    segment: float = 0.008,
    step: float = 0.004,
) -> tuple[np.ndarray, np.ndarray]:
    """Lay one rod until the end of its pattern, the grip still holding.

    Args:
        trial: on the plane table, without fixtures; its disturbance counts as in wrod.
        hold, release, speed: as in `simulate_deployments`.
        segment: length of a rigid segment where the rod is laid [m].
        step: time step [s].

    Returns:
        Arc length of the ends of the segments (n + 1,) and their positions (n + 1, 3) [m], at the
        height of the pattern's plane.

    Raises:
        MissingExtraError: MuJoCo is not installed.
        RodError: the rod is not uniform, or the simulation blew up.
    """
    (setup,) = prepare_trials(
        [trial], hold, hold if release is None else release, speed, Discretisation(segment)
    )
    rod, told = trial.rod, trial.disturbance
    if isinstance(rod, RodModel):
        raise RodError("the second engine plays uniform rods; give a RodMaterial")
    one = chain(
        setup.position,
        setup.director,
        held=setup.schedule.held_nodes - 1,
        step=step,
        lengths=np.diff(setup.arc_length),
        **_of(rod, told, trial.friction.static),
    )
    data = one.data
    hand = _hand(setup, one.nodes()[-1])
    released = False
    for _ in range(int(np.ceil(setup.measure_time / step))):
        t = data.time + step
        data.mocap_pos[0], data.mocap_quat[0] = hand(t + 2.0 * _WELD_TIME * step)
        if not released and t > setup.schedule.release_time:
            data.eq_active[1:], released = 0, True
        one.step()
    return setup.arc_length, one.nodes() - setup.lift


def put_down_in_mujoco(
    pattern: Pattern,
    rod: RodMaterial,
    friction: float,
    disturbance: Disturbance | None = None,
    step: float = 0.004,
) -> tuple[np.ndarray, np.ndarray]:
    """A rod that is put down exactly and left to itself (`wrod.bench.put_down`); `step` in [s].

    Returns:
        Arc length of the ends of the segments (n + 1,) and their positions (n + 1, 3) [m].
    """
    told = disturbance or Disturbance()
    length = pattern.length + pattern.remainder_length
    s = np.linspace(0.0, length, int(np.ceil(length / _SEGMENT)) + 1)
    place, tangent, _ = pattern.sample(s - pattern.remainder_length)
    lift = [0.0, 0.0, rod.radius - place[0, 2]]
    one = chain(
        told.displaced(place, place[0]) + lift,
        told.turned(np.cross([0.0, 0.0, 1.0], tangent[0])),
        hand=False,
        step=step,
        lengths=np.diff(s),
        **_of(rod, told, friction),
    )
    one.step(round(_LYING / one.model.opt.timestep))
    return s, one.nodes() - lift


def _of(rod: RodMaterial, told: Disturbance, friction: float) -> dict[str, Any]:
    """What a chain is told of a disturbed rod and its table."""
    return {
        "stiffness": rod.bending_stiffness * (1.0 + told.lgb_error) ** 3,
        "weight": rod.weight,
        "radius": rod.radius,
        "friction": friction,
        "natural_curvature": told.natural_curvature,
        "gravity": (0.0, 0.0, -rod.gravity),
    }


def _hand(setup: Setup, begin: np.ndarray):
    """Position and quaternion (wxyz) of the grip at a time [s], which comes from `begin` (3,)."""
    schedule = setup.schedule
    keys = KEY_INTERVAL * np.arange(len(schedule.position))
    position, quaternion = (
        CubicSpline(keys, values) for values in (schedule.position, schedule.rotation)
    )

    def at(t: float):
        t = min(t, float(keys[-1]))
        turned = np.roll(quaternion(t), 1)
        apart = blend(np.array(t), setup.approach) * (begin - schedule.position[0])
        return position(t) + apart, turned / np.linalg.norm(turned)

    return at


def _wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def _outward(bends: Rotation, root: int) -> np.ndarray:
    """Coordinates of the joints in MuJoCo's order: away from the root, first towards the grip."""
    return np.concatenate([_wxyz(bends[root:]), _wxyz(bends[:root].inv())[::-1]]).ravel()


def _model(length, mass, stiffness, radius, friction, held, hand, step, gravity) -> str:
    """MJCF of the chain along x, the table, a hand, and what holds the first segments."""
    touch = _TOUCH * radius
    count = len(length)

    def segment(k: int, start: float, joint: str, side: int) -> str:
        # A thin rod's inertia across, and a cylinder's about its axis.
        dx, m = length[k], mass[k]
        across, along = m * dx**2 / 12.0, 0.5 * m * radius**2
        touching = 0.0 if side > 0 else -dx
        return (
            f'<body name="s{k}" pos="{start:.12g} 0 0">{joint}<inertial pos="{side * 0.5 * dx:.12g}'
            f' 0 0" mass="{m:.12g}" diaginertia="{along:.12g} {across + 0.5 * along:.12g} '
            f'{across + 0.5 * along:.12g}"/>'
            f'<geom type="sphere" size="{touch:.9g}" pos="{touching:.12g} 0 0"/>'
        )

    def ball(k: int) -> str:
        """The joint at node k."""
        spring = stiffness / (0.5 * (length[k - 1] + length[k]))
        # A linearly implicit step: MuJoCo's constraints know of inertia alone, so that what the
        # end of the step asks of the springs is added to it.
        damping = spring * (INTERNAL_DAMPING + step)
        return (
            f'<joint type="ball" stiffness="{spring:.12g}" damping="{damping:.12g}" '
            f'armature="{step * damping:.12g}"/>'
        )

    # All hang on a segment in the middle: two short branches factorise faster than a long one.
    root = count // 2
    bodies = segment(root, 0.0, "<freejoint/>", 1)
    for k in range(root + 1, count):
        bodies += segment(k, length[k - 1], ball(k), 1)
    bodies += "</body>" * (count - 1 - root)
    for k in range(root - 1, -1, -1):
        bodies += segment(k, 0.0 if k == root - 1 else -length[k + 1], ball(k + 1), -1)
    bodies += "</body>" * (root + 1)
    last = len(length) - 1
    weld = f'solref="{_WELD_TIME * step} 1" solimp="0.9999 0.9999 0.0001"'
    holders = '<body name="hand" mocap="true"/>' if hand else ""
    holders += "".join(f'<body name="h{k}" mocap="true"/>' for k in range(held))
    welds = ""
    if hand:
        welds += (
            f'<weld body1="hand" body2="s{last}" relpose="{-length[-1]:.12g} 0 0 1 0 0 0" {weld}/>'
        )
    welds += "".join(
        f'<weld body1="h{k}" body2="s{k}" relpose="0 0 0 1 0 0 0" {weld}/>' for k in range(held)
    )
    return f"""<mujoco>
  <compiler inertiafromgeom="false" boundmass="0" boundinertia="0"/>
  <option timestep="{step}" integrator="Euler" cone="elliptic" impratio="100"
    gravity="{gravity[0]} {gravity[1]} {gravity[2]}" iterations="100" tolerance="1e-12">
    <flag eulerdamp="disable"/></option>
  <size memory="200M"/>
  <default><geom condim="3" friction="{friction}" contype="1" conaffinity="2"
    solref="{_CONTACT_TIME * step} 1" solimp="0.95 0.99 0.0001"/></default>
  <worldbody>
    <geom type="plane" size="5 5 1" pos="0 0 {radius - touch}" contype="2" conaffinity="1"/>
    {holders}{bodies}
  </worldbody>
  <equality>{welds}</equality>
</mujoco>"""
