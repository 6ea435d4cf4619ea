"""What a joint path keeps and where it fails, node by node."""

from dataclasses import dataclass

import numpy as np

from wrod.robot.collision import CollisionModel
from wrod.robot.grip import TravelledPath
from wrod.robot.kinematics import grasp_poses, manipulability, pose_error
from wrod.robot.model import Robot
from wrod.robot.redundancy import Surroundings, gaps

POSITION_TOLERANCE = 1e-4  # [m]
ROTATION_TOLERANCE = np.radians(0.1)
JUMP = 0.15  # [rad] between dense samples, which are under 2 mm of travel apart


@dataclass(frozen=True)
class PathReport:
    """Largest errors and smallest margins of a joint path over its dense samples.

    Attributes:
        position_error, rotation_error: of the grasp [m], [rad].
        limit_margin: least distance from a joint limit [rad].
        gap: least gap by kind ("links", "table", "laid rod") [m].
        manipulability: least sqrt(det(J J^T)).
        problem: one sentence on the first thing that fails, or None.
        shortfall: how badly it fails; 0 where nothing does.
    """

    position_error: float
    rotation_error: float
    limit_margin: float
    gap: dict[str, float]
    manipulability: float
    problem: str | None
    shortfall: float

    @property
    def quality(self) -> float:
        """Least of the margins, each over a comfortable value."""
        gap = min(self.gap.values(), default=float("inf"))
        return min(self.limit_margin / 0.4, gap / 0.04, self.manipulability / 0.08)


def inspect(
    robot: Robot,
    model: CollisionModel,
    path: TravelledPath,
    arc_length: np.ndarray,
    travel: np.ndarray,
    positions: np.ndarray,
    targets: np.ndarray,
    around: Surroundings,
    limit_margin: float,
    clearance: float,
) -> PathReport:
    """Check joint positions (K, n) at samples `travel` against grasp poses (K, 4, 4)."""
    import torch

    q = torch.tensor(positions)
    pose = torch.from_numpy(grasp_poses(robot, positions))
    error = pose_error(pose, torch.from_numpy(targets))
    off, turned = error[:, :3].norm(dim=-1).numpy(), error[:, 3:].norm(dim=-1).numpy()
    room = np.minimum(positions - robot.lower, robot.upper - positions)
    with torch.no_grad():
        distances = {kind: gap.numpy() for kind, gap in gaps(model, q, around).items()}
        measure = manipulability(robot.jacobian(q)[0]).numpy()
    distances = model.settle(distances, positions, around, clearance)

    def where(sample: int) -> str:
        node = path.node_of(travel[sample])
        return f"at node {node} (arc length {arc_length[node]:.3f} m)"

    problem, shortfall = None, 0.0
    missed = np.maximum(off / POSITION_TOLERANCE, turned / ROTATION_TOLERANCE)
    passed = room.min(1) < limit_margin
    jumps = np.abs(np.diff(positions, axis=0)).max(1)
    touching = (
        np.minimum.reduce([gap.min(1, initial=np.inf) for gap in distances.values()]) < clearance
    )
    if missed.max() > 1:
        k = int(missed.argmax())
        shortfall = 100.0 + off[k] + turned[k]
        problem = (
            f"the grip is out of reach {where(k)}: the nearest pose found is "
            f"{1e3 * off[k]:.1f} mm and {np.degrees(turned[k]):.1f} degrees away"
        )
    elif passed.any():
        k, joint = np.unravel_index(room.argmin(), room.shape)
        shortfall = 10.0 - room[k, joint]
        high = robot.upper[joint] - positions[k, joint] < positions[k, joint] - robot.lower[joint]
        limit = robot.upper[joint] if high else robot.lower[joint]
        what = (
            f"passes its limit of {limit:.4f} rad by {-room[k, joint]:.3f} rad"
            if room[k, joint] < 0
            else f"comes within {room[k, joint]:.3f} rad of its limit of {limit:.4f} rad, "
            f"nearer than the margin of {limit_margin:g} rad,"
        )
        problem = f"joint {robot.joint_names[joint]} {what} {where(k)}"
    elif jumps.max() > JUMP:
        k = int(jumps.argmax())
        shortfall = 5.0 + jumps[k]
        joint = robot.joint_names[int(np.abs(positions[k + 1] - positions[k]).argmax())]
        problem = f"joint {joint} jumps by {jumps[k]:.2f} rad {where(k)}, near a singularity"
    elif touching.any():
        kind = min(distances, key=lambda name: distances[name].min(initial=np.inf))
        k, column = np.unravel_index(distances[kind].argmin(), distances[kind].shape)
        gap = distances[kind][k, column]
        shortfall = 1.0 + clearance - gap
        if kind == "links":
            first, second = (model.links[i] for i in model.pairs[column])
        else:
            first, second = model.links[model.columns(kind)[column]], f"the {kind}"
        how = f"overlap by {-1e3 * gap:.1f} mm" if gap < 0 else f"come within {1e3 * gap:.1f} mm"
        problem = f"{first} and {second} {how} {where(k)}"
    return PathReport(
        float(off.max()),
        float(turned.max()),
        float(room.min()),
        {kind: float(gap.min()) for kind, gap in distances.items() if gap.size},
        float(measure.min()),
        problem,
        float(shortfall),
    )
