"""`wrod manifold`: the admissible grips of a straight pattern, their optima and stability."""

from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import CLOSURE, DEVICE
from wrod.errors import GraspError
from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(name="manifold", short_help="Map the grips that lay a straight pattern.")
@own_options
@CLOSURE
@DEVICE
@json_option
def command(
    closure: str,
    device: str,
    length: float = option("Suspended length [L_gb].", required=True),
    stretch_ratio: float = option("k_s [-].", default=2087.0),
    out: Path = option(None, type=FOLDER, required=True),
    rays: int = option("Rays from 5 to 175 degrees.", default=69),
    nudge: float = option("Sideways offset [L_gb].", default=0.12),
) -> None:
    """Map the grips that lay a straight pattern, and test which optimal grasps are stable.

    Writes the manifold with the force at the contact and the sideways deflection under a nudge
    (manifold.png), the optimal grasps under growing nudges (nudges.png), and the numbers
    (manifold.npz).
    """
    from wrod.grasps.manifold.map import force_map, save_map
    from wrod.grasps.manifold.picture import draw_map, draw_nudges

    if not 0.0 < nudge < length:
        raise GraspError(f"--nudge is {nudge:g}; give an offset between 0 and --length")
    work = cost.manifold(2 * rays**2, rays, device=device)
    cost.settle(work, f"a map of {rays} rays", "give fewer --rays")
    with cost.progress_bar(total=4, bar_format="{desc}: {n}/{total} {bar}") as bar:

        def progress(stage: str) -> None:
            bar.set_description_str(stage)
            bar.update()

        manifold = force_map(
            length,
            stretch_ratio,
            closure=closure,
            rays=rays,
            offset=nudge,
            device=device,
            progress=progress,
        )
    written = [
        draw_map(out / "manifold.png", manifold),
        draw_nudges(out / "nudges.png", manifold),
        save_map(out / "manifold.npz", manifold),
    ]
    figures = {**_figures(manifold), "written": [str(path) for path in written]}
    tell(figures, _summary(figures))


def _figures(manifold) -> dict:
    import numpy as np

    tests = manifold.tests()
    return {
        "suspended_length": manifold.suspended_length,
        "stretch_ratio": manifold.stretch_ratio,
        "closure": manifold.closure,
        "optima": [
            {
                "position": optimum.position.tolist(),
                "force": optimum.force.tolist(),
                "eigenvalue": optimum.eigenvalue,
                "stable": optimum.stable,
                "snaps_at": optimum.snaps_at if np.isfinite(optimum.snaps_at) else None,
            }
            for optimum in manifold.optima
        ],
        "largest_nudge": float(manifold.nudges.offset[-1]),
        "tested_grips": tests["tested"],
        "stable_grips": tests["stable"],
        "disagreeing_grips": tests["disagreeing"],
        "disagreeing_eigenvalue": tests["eigenvalue"],
    }


def _summary(figures: dict) -> str:
    lines = [
        f"suspended length {figures['suspended_length']:g} L_gb, stretch ratio "
        f"{figures['stretch_ratio']:g}, closure {figures['closure']}"
    ]
    for number, optimum in enumerate(figures["optima"], start=1):
        x, _, z = optimum["position"]
        word = "stable" if optimum["stable"] else "UNSTABLE"
        size = sum(f * f for f in optimum["force"]) ** 0.5
        snaps = (
            f"snaps when nudged by {optimum['snaps_at']:.3g}"
            if optimum["snaps_at"] is not None
            else f"holds when nudged by {figures['largest_nudge']:g}"
        )
        lines.append(
            f"optimum {number}: grip ({x:.4f}, {z:.4f}), |F| {size:.4f}, softest motion "
            f"{optimum['eigenvalue']:+.4f}: {word}; {snaps}"
        )
    lines.append(
        f"{figures['stable_grips']} of {figures['tested_grips']} grips of the map are stable; "
        f"eigenvalue and nudge disagree at {figures['disagreeing_grips']}"
        + (
            f" (|eigenvalue| up to {figures['disagreeing_eigenvalue']:.2g} there)"
            if figures["disagreeing_grips"]
            else ""
        )
    )
    return "\n".join(lines)
