"""How far heavy rods droop, clamped level: discrete rods beside the continuum.

Reference drops and reaches are those of the heavy elastica, computed by collocation.
"""

from pathlib import Path

import numpy as np
from _picture import panels, save

import wrod

# w L^3 / B: (drop, reach) over L
REFERENCE = {1: (0.12347, 0.99125), 10: (0.70020, 0.65635), 100: (0.93752, 0.15922)}


def droop(gamma: float, edges: int) -> np.ndarray:
    """(node, 3) of a rod of unit length and stiffness whose weight per length is gamma."""
    rod = wrod.RodModel(
        length=1.0, bending_stiffness=1.0, twisting_stiffness=1.0, stretching_stiffness=1e6,
        line_mass=gamma, radius=0.01, gravity=1.0,
    )  # fmt: skip
    s = np.arange(-1, edges + 1) / edges  # the first edge is the clamp's
    straight = np.column_stack([s, 0 * s, 0 * s])
    batch = wrod.RodBatch.of(rod, s, straight[None], clamped=(True, False))
    wrod.prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    found = wrod.solve_equilibria(batch, ramp_loads=True)
    assert found.converged.all()
    return batch.positions()[0, 1:]


def main(out: str | Path = "out/examples") -> Path:
    figure, (shapes, errors) = panels(2)
    edges = np.array([10, 20, 40, 80])
    for gamma, (drop, _) in REFERENCE.items():
        lines = [droop(gamma, n) for n in edges]
        shapes.plot(lines[-1][:, 0], lines[-1][:, 2], label=f"w L³ / B = {gamma}")
        error = [abs(-line[-1, 2] - drop) for line in lines]
        print(f"{gamma:4d}: error of the drop {error[-1]:.1e} of the length with {edges[-1]} edges")
        errors.loglog(edges, error, "o-")
    shapes.set(aspect="equal", xlabel="x / L", ylabel="z / L")
    shapes.legend(frameon=False)
    errors.set(xlabel="edges", ylabel="error of the drop / L")
    return save(figure, out, "heavy_cantilever")


if __name__ == "__main__":
    main()
