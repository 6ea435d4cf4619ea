"""Where the results of grasps go on a device."""

import warp as wp

from wrod.grasps.results import SENSITIVITIES
from wrod.kernels.grasping.reading import Results
from wrod.machine import require_memory


def empty_results(
    rods: int, edges: int, device: str, *, sensitivities: bool, shapes: bool
) -> Results:
    """Uninitialised arrays of `Grasps`; what is not asked for has no entries.

    Raises:
        DataError: this machine has no memory for them.
    """
    if device == "cpu":
        entries = 20 + 9 * len(SENSITIVITIES) * sensitivities + 4 * (edges + 1) * shapes
        remedy = "ask for fewer at once" + (", or for no shapes" if shapes else "")
        require_memory(8.0 * rods * entries, f"{rods} grasps", remedy)
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
