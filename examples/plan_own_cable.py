"""From a cable and a curve of your own to the grip's path.

Fold the cable over on a table, measure how high the loop's centreline stands, and give the points
of the curve. The plan is written as a table and drawn.
"""

from pathlib import Path

import numpy as np

import wrod
from wrod.planning.picture import draw_plan


def main(out: str | Path = "out/examples") -> Path:
    cable = wrod.RodMaterial.from_loop_height(loop_height=0.0366, radius=0.0016, length=0.9)
    x = np.linspace(0.0, 0.45, 60)
    curve = wrod.Pattern.from_points(np.column_stack([x, 0.06 * np.sin(2 * np.pi * x / 0.45)]))
    trajectory = wrod.plan(curve, cable)
    print(f"{len(trajectory)} poses; the grip starts {trajectory.position[0, 2]:.3f} m high")
    trajectory.save(Path(out) / "own_cable.npz")
    return draw_plan(Path(out) / "plan_own_cable.png", curve, trajectory)


if __name__ == "__main__":
    main()
