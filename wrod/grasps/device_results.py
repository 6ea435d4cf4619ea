"""Where the results of grasps go on a device."""

import warp as wp

from wrod.grasps.results import SENSITIVITIES
from wrod.kernels.grasping.reading import Results
from wrod.machine import available_memory, require_memory

# What is read out of them always, and with the rods' shapes.
FIELDS = (
    "position", "rotation", "force", "force_jacobian", "converged", "stable", "iterations",
    "residual",
)  # fmt: skip
SHAPES = ("shape", "arc_length")
# Solved at once at least, and the share of what is free that is taken for them.
_LEAST, _SHARE = 32, 0.8


def result_bytes(edges: int, *, sensitivities: bool, shapes: bool) -> float:
    """Of the results of one grasp."""
    return 8.0 * (20 + 9 * len(SENSITIVITIES) * sensitivities + 4 * (edges + 1) * shapes)


def at_once(rods: int, most: int, kept: float, working: float, device: str) -> int:
    """Grasps that are solved at once: as many as fit, at most `most`.

    Args:
        rods: all of them.
        kept: bytes of each that stay until all are solved.
        working: bytes of each while it is solved.

    Raises:
        DataError: not even a few fit beside what stays.
    """
    remedy = "ask for fewer at once, for no shapes, or for a smaller edge_count"
    least = min(rods, most, _LEAST)
    require_memory(rods * kept + least * working / _SHARE, f"{rods} grasps", remedy, device)
    room = _SHARE * (available_memory(device) - rods * kept)
    return most if room >= most * working else max(least, int(room / working))


def empty_results(
    rods: int, edges: int, device: str, *, sensitivities: bool, shapes: bool
) -> Results:
    """Uninitialised arrays of `Grasps`; what is not asked for has no entries."""
    out = Results()

    def floats(*shape, wanted=True):
        size = shape if wanted else (0,) * len(shape)
        return wp.empty(size, dtype=wp.float64, device=device)

    out.position, out.rotation, out.force = (floats(rods, 3) for _ in range(3))
    out.force_jacobian = floats(rods, 3, 3)
    for name in SENSITIVITIES:
        setattr(out, name, floats(rods, 3, 3, wanted=sensitivities))
    out.shape = floats(rods, edges + 1, 3, wanted=shapes)
    out.arc_length = floats(rods, edges + 1, wanted=shapes)
    out.converged = wp.empty(rods, dtype=wp.bool, device=device)
    out.stable = wp.empty(rods, dtype=wp.bool, device=device)
    out.iterations = wp.empty(rods, dtype=wp.int32, device=device)
    out.residual = floats(rods)
    return out
