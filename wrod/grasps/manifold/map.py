"""The manifold of grasps of a straight pattern: forces, stability, optima. Dimensionless."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wrod import arguments
from wrod.errors import GraspError
from wrod.files import write_npz
from wrod.grasps.inputs import check_inputs, closure_number
from wrod.grasps.manifold.boundary import EMPTY, Boundary, boundary
from wrod.grasps.manifold.grips import EDGE_COUNT, grasp_shapes
from wrod.grasps.manifold.optima import Optimum, find_optima
from wrod.grasps.manifold.sampler import Patch, Sampler
from wrod.grasps.nudge import Nudges
from wrod.rods.device import resolve_device

# The sideways offset of the paper's Fig. 2Dschematic (d) [L_gb].
OFFSET = 0.12


@dataclass(frozen=True)
class ForceMap:
    """The manifold of one (l_s, k_s).

    The force alone is least, and zero, on the tight edge, where the clamp holds the rod by a couple
    that no table can give. Optimal grasps (Eq. optimize) have no curvature at the contact and none
    at the grip: they stand on the low edge, and the closure chooses among them.

    Attributes:
        suspended_length, stretch_ratio, closure, offset: inputs.
        boundary: rays through the manifold.
        patches: the manifold itself: the part that the rays see and, where the rod leans over
            backwards, the overhang below it that they do not.
        optima: optimal grasps, smallest force first.
        nudges: what happens to the optima when they are nudged sideways.
    """

    suspended_length: float
    stretch_ratio: float
    closure: str
    offset: float
    boundary: Boundary
    patches: list[Patch]
    optima: list[Optimum]
    nudges: Nudges

    def tests(self) -> dict[str, float]:
        """How many grips of the map were tested, are stable, and where the two tests disagree: the
        sign of the eigenvalue, and whether a small nudge makes the rod leave its branch."""
        value = np.concatenate([patch.eigenvalue.ravel() for patch in self.patches])
        snaps = np.concatenate([patch.snaps.ravel() for patch in self.patches])
        differ = (value < 0.0) != snaps
        return {
            "tested": int(value.size),
            "stable": int(np.sum(value >= 0.0)),
            "disagreeing": int(differ.sum()),
            "eigenvalue": float(np.abs(value[differ]).max(initial=0.0)),
        }


def force_map(
    suspended_length: float,
    stretch_ratio: float,
    *,
    closure: str = "zero_tension",
    rays: int = 69,
    offset: float = OFFSET,
    device: arguments.DeviceLike = None,
    threads: int | None = None,
    progress: Callable[[str], object] | None = None,
) -> ForceMap:
    """Boundary, forces, stability, sideways deflection and optima of one straight pattern.

    Args:
        suspended_length, stretch_ratio: l_s [L_gb], k_s [-].
        closure: which of the grasps without curvature at both ends are optimal.
        rays: rays from 5 to 175 degrees.
        offset: sideways offset for the deflection [L_gb].
        device, threads: as in `solve_grasps`.
        progress: called with the name of every stage.

    Raises:
        GraspError: inputs out of range, an unknown closure, or no ray that holds a grip.
    """
    closure_number(closure)
    ls, _, ks = check_inputs(suspended_length, 0.0, stretch_ratio)
    if len(ls) != 1:
        raise GraspError("a force map has one suspended length and one stretch ratio")
    device = resolve_device(device)
    say = progress or (lambda stage: None)
    say("boundary")
    angle = np.radians(np.linspace(5.0, 175.0, rays))
    edge = boundary(ls, ks, angle, device=device, threads=threads)
    if (edge.kind[0] == EMPTY).all():
        raise GraspError(
            f"no grip on {rays} rays lays a rod of {ls[0]:g} L_gb with stretch ratio {ks[0]:g}; "
            "give a shorter one, more rays or a larger ratio"
        )
    say("forces")
    start = grasp_shapes(ls, 0.0 * ls, ks, EDGE_COUNT, device, threads)[0]
    maps = Sampler(float(ls[0]), float(ks[0]), start, offset, device, threads)
    patches = [maps.seen(edge)]
    overhang = maps.overhang(edge)
    if overhang is not None:
        patches.append(overhang)
    say("optima")
    optima, nudges = find_optima(patches, float(ls[0]), float(ks[0]), closure, device)
    return ForceMap(float(ls[0]), float(ks[0]), closure, offset, edge, patches, optima, nudges)


def save_map(path: str | os.PathLike[str], manifold: ForceMap) -> Path:
    """Write a force map as NPZ: plain arrays, dimensionless. Returns the path."""
    asked = ("suspended_length", "stretch_ratio", "closure", "offset")
    arrays: dict[str, Any] = {name: np.array(getattr(manifold, name)) for name in asked}
    arrays["boundary_angle"] = manifold.boundary.angle
    for name in ("tight", "low", "kind"):
        arrays[f"boundary_{name}"] = getattr(manifold.boundary, name)[0]
    for name in ("offset", "force", "deflection"):
        arrays[f"nudge_{name}"] = getattr(manifold.nudges, name)
    for name in ("position", "force", "shape", "eigenvalue", "stable", "snaps_at"):
        arrays[f"optimum_{name}"] = np.array([getattr(o, name) for o in manifold.optima])
    for number, patch in enumerate(manifold.patches):
        for name in ("position", "force", "eigenvalue", "snaps", "deflection", "shape"):
            arrays[f"patch_{number}_{name}"] = getattr(patch, name)
    return write_npz(path, **arrays)
