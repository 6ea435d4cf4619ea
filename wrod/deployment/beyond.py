"""What hangs beyond the grip, in a deployment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wrod.deployment.setup import Setup
from wrod.deployment.trial import Trial
from wrod.errors import RodError
from wrod.planning.beyond import hanging, off_the_table
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod

# Fewest edges that hang, and length of the held one [radii].
_FEWEST, _HELD = 4, 0.25


def edges_beyond(trials: Sequence[Trial], spacing: float) -> int:
    """Edges of what hangs beyond the grips, as long as where rods are laid; 0: nothing does.

    Raises:
        RodError: of some rods only something hangs there.
    """
    beyond = [trial.trajectory.beyond_grip for trial in trials]
    if not any(beyond):
        return 0
    if not all(beyond):
        raise RodError(
            "beyond_grip: some trajectories hold the rod at its end, others nearer; lay them apart"
        )
    return max(int(np.ceil(max(beyond) / spacing)), _FEWEST)


def hung_beyond(setup: Setup, rod: Rod, trajectory: Trajectory, edges: int) -> Setup:
    """The same deployment of the whole rod: what is beyond the grip hangs from it at rest, and
    where it comes down to the table lies on it.

    The grip holds an edge that is short beside the rod's radius; what is on either side of it
    answers to the grip alone.

    Raises:
        RodError: no rest was found.
    """
    beyond = trajectory.beyond_grip
    s = np.insert(np.linspace(min(_HELD * rod.radius, 0.5 * beyond), beyond, edges), 0, 0.0)
    pose = setup.schedule.poses(np.zeros(1))
    lift = [0.0, 0.0, rod.radius]  # of the rod's middle when it lies
    hangs = hanging(rod, s, pose[:, :3, 3] - lift, pose[:, :3, :3], trajectory.roll)
    if hangs is None:
        raise RodError(
            f"what hangs beyond the grip, {beyond:.3f} m, finds no rest where the trajectory begins"
        )
    held = len(setup.arc_length) - 1
    return replace(
        setup,
        arc_length=np.concatenate([setup.arc_length, setup.arc_length[-1] + s[1:]]),
        position=np.concatenate([setup.position, off_the_table(hangs[0])[1:] + lift]),
        schedule=replace(setup.schedule, held_edge=held),
    )
