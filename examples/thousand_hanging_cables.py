"""A thousand cables hung between two pins, each with its own distance, in one batch."""

from pathlib import Path

import numpy as np
from _picture import panels, sagging, save

import wrod


def main(out: str | Path = "out/examples", count: int = 1000, edges: int = 30) -> Path:
    cable = wrod.RodMaterial(radius=0.002, gravito_bending_length=0.05, length=0.6)
    s = np.linspace(0.0, cable.length, edges + 1)
    apart = np.linspace(0.3, 0.59, count)
    position = np.stack([sagging(s, distance) for distance in apart])
    batch = wrod.RodBatch.of(cable, s, position)
    wrod.prescribe(batch, pinned_nodes=(0, -1), clamped_angles=(0,))
    found = wrod.solve_equilibria(batch)
    low = -batch.positions()[:, :, 2].min(axis=1)
    print(f"{found.converged.sum()} of {count} at rest")
    figure, (shapes, sags) = panels(2)
    for row in np.linspace(0, count - 1, 8).astype(int):
        shapes.plot(*batch.positions()[row][:, [0, 2]].T, color="#0b5fa5", lw=1.2)
    shapes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
    sags.plot(apart[found.converged], low[found.converged], color="#d9822b")
    sags.set(xlabel="distance of the pins [m]", ylabel="sag [m]")
    return save(figure, out, "thousand_hanging_cables")


if __name__ == "__main__":
    main()
