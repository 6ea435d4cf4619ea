"""`wrod bench table4`: the paper's Table 4, times and errors of the controller, measured here."""

import time
from pathlib import Path

import click

from wrod import cost
from wrod.errors import GraspError
from wrod.machine import machine_line
from wrod.options import FILE, SOURCE_FOLDER, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell

RODS = ("pink-vps", "green-vps", "rope")
# Published in Table 4 for rods 1 to 3: numeric solver [s], network [s], position error [m],
# orientation error, pattern by pattern.
PATTERNS = ("line", "circle", "sine", "letterU", "letterC", "letterL", "letterA")
PAPER = {
    "pink-vps": (
        (1572.68, 2036.11, 2897.17, 3954.12, 4015.24, 4777.30, 4666.55),
        (0.402, 0.393, 0.395, 0.431, 0.431, 0.400, 0.417),
        (0.0008, 0.0007, 0.0009, 0.0008, 0.0007, 0.0008, 0.0008),
        (0.0012, 0.0010, 0.0032, 0.0025, 0.0020, 0.0020, 0.0021),
    ),
    "green-vps": (
        (776.56, 1213.14, 1769.66, 2286.66, 2226.73, 2720.08, 2933.90),
        (0.397, 0.391, 0.396, 0.419, 0.408, 0.404, 0.406),
        (0.0016, 0.0016, 0.0019, 0.0018, 0.0016, 0.0020, 0.0017),
        (0.0012, 0.0078, 0.0050, 0.0042, 0.0020, 0.0058, 0.0030),
    ),
    "rope": (
        (666.01, 1041.71, 1561.12, 1984.63, 1972.39, 2405.71, 2639.44),
        (0.400, 0.407, 0.395, 0.407, 0.420, 0.405, 0.411),
        (0.0016, 0.0017, 0.0020, 0.0020, 0.0016, 0.0021, 0.0018),
        (0.0010, 0.0087, 0.0052, 0.0055, 0.0023, 0.0054, 0.0032),
    ),
}
NODES = dict(zip(PATTERNS, (101, 156, 138, 190, 190, 190, 194), strict=True))


def cell(curve, rod, controller, device: str, nodes: int) -> dict:
    """One cell of the table: numeric grasps against the controller's.

    The position error is the mean distance [m], the orientation error the mean absolute
    difference of the quaternions' components; both also as the largest over the nodes.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from wrod.grasps.optimal import solve_grasps

    s = np.linspace(0.0, curve.length, nodes)
    lgb = rod.gravito_bending_length
    inputs = ((rod.length - s) / lgb, curve.sample(s)[2] * lgb, np.full(nodes, rod.stretch_ratio))
    clock = time.perf_counter()
    grasps = solve_grasps(*inputs, closure=controller.closure, device=device, shapes=False)
    numeric = time.perf_counter() - clock
    if not grasps.converged.all():
        raise GraspError(f"{curve.name}: {np.sum(~grasps.converged)} grasps did not converge")
    times = []
    for _ in range(7):
        clock = time.perf_counter()
        position, rotation = controller.predict(*inputs)
        times.append(time.perf_counter() - clock)
    distance = lgb * np.linalg.norm(position - grasps.position, axis=1)
    quaternion = [Rotation.from_rotvec(r).as_quat() for r in (rotation, grasps.rotation)]
    # q and -q are one rotation.
    sign = np.where(np.sum(quaternion[0] * quaternion[1], axis=1) < 0.0, -1.0, 1.0)
    turn = np.abs(quaternion[0] - sign[:, None] * quaternion[1])
    return {
        "nodes": nodes,
        "numeric_seconds": numeric,
        "neural_seconds": float(np.median(times)),
        "position_error": float(distance.mean()),
        "position_error_max": float(distance.max()),
        "orientation_error": float(turn.mean()),
        "orientation_error_max": float(turn.max()),
    }


@click.command(name="table4")
@own_options
@json_option
def command(
    patterns: Path = option(
        "Folder with the paper's patterns: line.txt, circle.txt, ..., letterA.txt.",
        type=SOURCE_FOLDER,
        required=True,
    ),
    weights: Path | None = option(
        "Controller file; default: the one that ships.", "--controller", type=FILE
    ),
    closure: str = option("Of the one that ships.", default="zero_tension"),
    device: str = option("Of the numeric solver.", default="auto"),
) -> None:
    """Compare controller and numeric solver on rods 1 to 3 and the paper's seven patterns.

    Both solve the controller's closure; the paper's figures are those of no tension."""
    from wrod.controller.controller import Controller
    from wrod.grasps.optimal import solve_grasps
    from wrod.patterns.pattern import Pattern
    from wrod.rods.catalogue import rod
    from wrod.rods.device import resolve_device

    if weights is not None:
        refuse_idle_options("--controller", "closure")
    device = resolve_device(device)
    controller = Controller.load(weights, closure=closure)
    curves = {name: Pattern.load(patterns / f"{name}.txt") for name in PATTERNS}
    # Compile outside the clock.
    solve_grasps([5.0], [0.5], [1e3], closure=controller.closure, device=device)
    rows = []
    for name in cost.progress_bar(RODS, unit="rod"):
        for column, pattern in enumerate(PATTERNS):
            figures = cell(curves[pattern], rod(name), controller, device, NODES[pattern])
            published = [row[column] for row in PAPER[name]]
            keys = ("numeric_seconds", "neural_seconds", "position_error", "orientation_error")
            paper = dict(zip(keys, published, strict=True))
            rows.append({"rod": name, "pattern": pattern, **figures, "paper": paper})
    tell(
        {"machine": machine_line(device), "rows": rows},
        "each figure beside the paper's; errors are means over the nodes, (largest)",
        f"{'rod':>10} {'pattern':>8} {'nodes':>5} {'numeric [s]':>16} {'network [ms]':>14} "
        f"{'position [mm]':>22} {'quaternion [1e-3]':>22}",
        *(
            f"{row['rod']:>10} {row['pattern']:>8} {row['nodes']:5d} "
            f"{row['numeric_seconds']:7.2f} {row['paper']['numeric_seconds']:8.0f} "
            f"{1e3 * row['neural_seconds']:8.2f} {1e3 * row['paper']['neural_seconds']:5.0f} "
            f"{1e3 * row['position_error']:9.4f} ({1e3 * row['position_error_max']:.4f}) "
            f"{1e3 * row['paper']['position_error']:4.1f} "
            f"{1e3 * row['orientation_error']:9.4f} ({1e3 * row['orientation_error_max']:.4f}) "
            f"{1e3 * row['paper']['orientation_error']:4.1f}"
            for row in rows
        ),
    )
