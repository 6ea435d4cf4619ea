"""A cable swings from a pin: damping inside the material brakes bending, not the swing."""

from pathlib import Path

import numpy as np
from _picture import panels, save

import wrod


def main(out: str | Path = "out/examples", seconds: float = 2.0, edges: int = 20) -> Path:
    cable = wrod.RodMaterial(radius=0.002, gravito_bending_length=0.04, length=0.4)
    s = np.linspace(0.0, cable.length, edges + 1)
    straight = np.column_stack([s, 0 * s, 0 * s])
    figure, axes = panels()
    for damping, color in ((0.0, "#0b5fa5"), (0.02, "#d9822b")):
        batch = wrod.RodBatch.of(cable, s, straight[None])
        wrod.prescribe(batch, pinned_nodes=(0,), clamped_angles=(0,))
        moving = wrod.Dynamics(batch, radius=cable.radius, internal_damping=damping)
        times = np.linspace(0.0, seconds, 80)
        x = []
        for time in times:
            moving.advance(time, 0.01)
            x.append(batch.positions()[0, -1, 0])
        axes.plot(times, x, color=color, label=f"internal damping {damping:g} s")
        print(f"internal damping {damping:g} s: energy {moving.energy()[0]:.5f} J at the end")
    axes.set(xlabel="time [s]", ylabel="x of the free end [m]")
    axes.legend(frameon=False)
    return save(figure, out, "swinging_cable")


if __name__ == "__main__":
    main()
