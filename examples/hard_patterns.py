"""Patterns that are hard to lay: tight, closed or crossing; a folder for `--patterns` of benches.

python examples/hard_patterns.py
wrod bench slippery --patterns out/hard-patterns --names spiral,gee,zigzag ... --out out/hard
"""

from pathlib import Path

import numpy as np
from _picture import panels, save
from scipy.ndimage import gaussian_filter1d

# Step along the pieces, deviation over which their curvature is smoothed, distance of points [m].
STEP, SMOOTH, SPACING = 2e-4, 6e-3, 2e-3


def pieces(heading: float, *parts: tuple[float, float]) -> np.ndarray:
    """(n, 2) points along straights (length [m], 0) and arcs (radius [m], turn [degrees], left
    positive), from a heading [degrees] on."""
    curvature = []
    for size, turn in parts:
        length = abs(np.deg2rad(turn)) * size if turn else size
        curvature.append(np.full(round(length / STEP), np.sign(turn) / size if turn else 0.0))
    bend = gaussian_filter1d(np.concatenate(curvature), SMOOTH / STEP, mode="nearest")
    angle = np.deg2rad(heading) + np.concatenate([[0.0], STEP * np.cumsum(bend)])
    return STEP * np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)


def circle(radius: float) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, 3000)
    return radius * np.column_stack([np.sin(t), 1.0 - np.cos(t)])


def patterns() -> dict[str, np.ndarray]:
    t = np.linspace(0.0, 2.6 * np.pi, 4000)
    spiral = (0.11 - 0.028 * t / np.pi)[:, None] * np.column_stack([np.cos(t), np.sin(t)])
    u = np.linspace(-0.5 * np.pi, 1.5 * np.pi, 4000)
    eight = np.column_stack([np.cos(u), 1.3 * np.sin(u) * np.cos(u)])
    x = np.linspace(0.0, 0.5, 6000)
    wave = 0.022 * np.sin(2.0 * np.pi * (2.4 * x + 5.2 * x**2))
    return {
        "spiral": spiral,
        "eight": 0.105 * eight / (1.0 + np.sin(u) ** 2)[:, None],
        "circle35": circle(0.035),
        "circle45": circle(0.045),
        "ess": pieces(0, (0.08, 0), (0.035, 180), (0.06, 0), (0.035, -180), (0.08, 0)),
        "stadium": pieces(0, (0.06, 0), (0.03, 180), (0.12, 0), (0.03, 180), (0.06, 0)),
        "zigzag": pieces(-55, *(((0.09, 0), (0.025, 110), (0.09, 0), (0.025, -110)) * 2)[:-1]),
        "chirp": np.column_stack([x, wave]),
        "gee": pieces(140, (0.055, 300), (0.02, 90), (0.05, 0)),
        "two": pieces(80, (0.04, -215), (0.09, 0), (0.02, 135), (0.11, 0)),
        "arr": pieces(
            90, (0.12, 0), (0.02, -90), (0.03, 0), (0.033, -180), (0.02, 0), (0.02, 135), (0.11, 0)
        ),
    }  # fmt: skip


def main(out: str | Path = "out/hard-patterns") -> Path:
    figure, axis = panels()
    Path(out).mkdir(parents=True, exist_ok=True)
    for k, (name, points) in enumerate(patterns().items()):
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        s = np.linspace(0.0, along[-1], int(along[-1] / SPACING) + 1)
        x, y = (np.interp(s, along, points[:, c] - points[0, c]) for c in (0, 1))
        np.savetxt(Path(out) / f"{name}.txt", np.column_stack([x, y, 0.0 * s]), fmt="%.6f")
        across, down = 0.6 * (k % 4), 0.4 * (k // 4)
        axis.plot(across + x, y - down)
        axis.text(across, 0.17 - down, name, fontsize=8)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return save(figure, out, "hard_patterns")


if __name__ == "__main__":
    main()
