"""Run the examples of this folder without a display, check them, and draw them at some times.

Run: `python examples/newton/pictures.py [DEVICE]`, which writes out/examples/newton.png.
"""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import newton
import numpy as np
from newton.viewer import ViewerNull
from scipy.spatial.transform import Rotation

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import MaxNLocator

HERE = Path(__file__).parent
# Example, its title, times that are drawn [s], view (elevation, azimuth), axes' limits (x, y, z).
SCENES = {
    "crane": (
        "A beam on two cables", (0.02, 1.2, 6.0), (8, -75),
        ((-0.3, 0.7), (-0.2, 0.2), (0.4, 1.15)),
    ),
    "cable_pile": (
        "Eight cables on a heap", (2.5,), (35, -60),
        ((-0.15, 0.15), (-0.15, 0.15), (0.0, 0.08)),
    ),
    "arm_carries_cable": (
        "An arm carries a cable", (0.02, 2.2, 4.4), (10, -80),
        ((-0.05, 0.75), (-0.2, 0.2), (0.0, 0.5)),
    ),
    "gripper_picks_cable": (
        "A Panda picks a cable up", (0.9, 3.2, 5.6), (10, -80),
        ((-0.15, 0.75), (-0.2, 0.2), (0.0, 0.75)),
    ),
    "y_junction": (
        "A junction swings down", (0.02, 0.2, 7.0), (15, -60),
        ((-0.2, 0.4), (-0.3, 0.3), (0.4, 1.05)),
    ),
    "twist_transfer": (
        "Shafts turn evenly around a bend", (7.0,), (60, -90),
        ((-0.1, 1.5), (-0.1, 0.55), (-0.1, 0.1)),
    ),
    "bundle_hysteresis": (
        "A bundle under pegs, and let go", (1.2, 4.0), (40, -80),
        ((-0.35, 0.35), (-0.1, 0.1), (-0.03, 0.06)),
    ),
    "plectoneme": (
        "A slack cable, turned six times", (1.0, 5.0, 9.0), (60, -80),
        ((0.0, 0.32), (-0.12, 0.12), (-0.05, 0.15)),
    ),
    "flick_cable": (
        "A hand flicks a cable onto a mark", (0.1, 0.3, 0.5, 0.7, 0.9), (12, -75),
        ((-0.15, 0.35), (-0.15, 0.25), (0.15, 0.65)),
    ),
}  # fmt: skip

STANDING = (newton.GeoType.CAPSULE, newton.GeoType.CYLINDER)


def run(name: str, times, device: str) -> list:
    """Positions of nodes by rod, and of the example's links or beam, at the times."""
    sys.path.insert(0, str(HERE))
    module = importlib.import_module(name)
    example = module.Example(ViewerNull(num_frames=1), SimpleNamespace(device=device))
    frames = [round(t / example.frame_dt) for t in times]
    out = []
    for k in range(1, example.frame_count + 1):
        example.step()
        if k in frames:
            out.append((rods(example), bodies(example)))
    example.test_final()
    print(f"{name}: meets its criteria")
    return out


def rods(example) -> list[np.ndarray]:
    der = example.model.der
    q = example.state.der.node_q.numpy().copy()
    spans = zip(der.rod_first_node.numpy(), der.rod_node_count.numpy(), strict=True)
    return [q[first : first + count] for first, count in spans]


def bodies(example) -> list[np.ndarray]:
    """Both ends of the solids on the bodies, but of cables' capsules."""
    model, out = example.model, []
    poses, own = example.state.body_q.numpy(), model.shape_transform.numpy()
    kinds, sizes = model.shape_type.numpy(), model.shape_scale.numpy()
    for shape, body in enumerate(model.shape_body.numpy()):
        if body >= 0 and "/capsule_" not in model.shape_label[shape]:
            size, turn = sizes[shape], Rotation.from_quat(poses[body, 3:])
            middle = poses[body, :3] + turn.apply(own[shape, :3])
            way = [size[0] * (kinds[shape] == newton.GeoType.BOX), 0.0, 0.0]
            if kinds[shape] in STANDING:
                way = [0.0, 0.0, size[1]]
            way = (turn * Rotation.from_quat(own[shape, 3:])).apply(way)
            out.append(middle + np.array([[-1.0], [1.0]]) * way)
    return out


def main(device: str = "cpu", out: str | Path = "out/examples") -> Path:
    figure = plt.figure(figsize=(19, 9), layout="constrained")
    for k, (name, (title, times, view, limits)) in enumerate(SCENES.items()):
        axes = figure.add_subplot(2, -(-len(SCENES) // 2), k + 1, projection="3d")
        found = run(name, times, device)
        for moment, (lines, boxes) in enumerate(found):
            shade = (moment + 1) / len(found)
            for i, q in enumerate(lines):
                color = plt.cm.viridis(i / max(1, len(lines) - 1)) if len(found) == 1 else "#0b5fa5"
                axes.plot(*q.T, color=color, alpha=0.25 + 0.75 * shade, lw=3.0)
            for ends in boxes:
                axes.plot(
                    *ends.T, color="#22262b", alpha=0.2 + 0.6 * shade, lw=6.0,
                    marker="o" if (ends[0] == ends[1]).all() else "",
                )  # fmt: skip
        axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2], title=title)
        axes.set_box_aspect([b - a for a, b in limits])
        axes.view_init(*view)
        axes.tick_params(labelsize=7)
        axes.yaxis.set_major_locator(MaxNLocator(3))
        axes.zaxis.set_major_locator(MaxNLocator(3))
    path = Path(out) / "newton.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)
    print(path)
    return path


if __name__ == "__main__":
    main(*sys.argv[1:2])
