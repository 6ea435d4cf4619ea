"""Rods of recorded motion as a batch."""

import numpy as np

from wrod.rods.batch import RodBatch


def rods_on_mesh(
    values: dict[str, np.ndarray],
    position: np.ndarray,
    director: np.ndarray,
    point_load: np.ndarray,
    device: str,
    **own,
) -> RodBatch:
    """A batch of rods that are alike.

    Args:
        values: as of `MotionSetup.arrays`, real.
        position, director, point_load, own: as `RodBatch` takes them; weight is a point load, for
            it and other forces per mass may change along the rod.
    """
    stiffness, rest = values["stiffness"], values["rest_strain"]
    return RodBatch(
        position,
        stretching_stiffness=values["stretching"],
        bending_stiffness=stiffness[None, :, :2],
        twisting_stiffness=stiffness[:, 2],
        natural_curvature=rest[:, :2],
        natural_twist=rest[:, 2],
        softening=values["softening"],
        point_load=point_load,
        director=director,
        device=device,
        **own,
    )
