"""Optimal grasps of a thousand suspended rods at once, and what curvature and closure change."""

from pathlib import Path

import numpy as np
from _picture import panels, save

import wrod


def main(out: str | Path = "out/examples", count: int = 200) -> Path:
    kappa = np.linspace(0.0, 2.0, count)
    figure, axes = panels(2)
    for closure, color in (("zero_tension", "#0b5fa5"), ("min_friction", "#d9822b")):
        grasps = wrod.solve_grasps(10.0, kappa, 2087.0, closure=closure)
        good = grasps.converged
        print(f"{closure}: {good.sum()} of {count} converged")
        axes[0].plot(kappa[good], grasps.position[good], color=color)
        side = np.hypot(grasps.force[good, 0], grasps.force[good, 1])
        axes[1].plot(kappa[good], side / grasps.force[good, 2], color=color, label=closure)
    axes[0].set(xlabel="curvature [1/L_gb]", ylabel="grip position x, y, z [L_gb]")
    axes[1].set(xlabel="curvature [1/L_gb]", ylabel="friction that the table must give [-]")
    axes[1].legend(frameon=False)
    return save(figure, out, "grasps_over_curvature")


if __name__ == "__main__":
    main()
