"""`wrod deploy PATTERN`: lay the rod in simulation and measure how well it lies."""

from dataclasses import replace
from pathlib import Path

import click

from wrod import cost
from wrod.commands.deploy_options import Laying, Planned
from wrod.commands.options import DEVICE, UNITS, PatternOptions, RodOptions
from wrod.options import FOLDER, gathered, option, own_options
from wrod.telling import json_option, tell


@click.command(name="deploy")
@click.argument("pattern")
@gathered("rod_options", RodOptions)
@own_options
@gathered("planned", Planned)
@gathered("reading", PatternOptions, UNITS)
@gathered("laying", Laying)
@DEVICE
@cost.force_option
@json_option
def command(
    pattern: str,
    rod_options: RodOptions,
    planned: Planned,
    reading: PatternOptions,
    laying: Laying,
    device: str,
    out: Path = option(None, type=FOLDER, required=True),
) -> None:
    """Lay a rod along PATTERN in simulation, and measure it.

    The free end's first 5 cm are held at first. The rod is measured at the end of the pattern with
    the grip holding, and again after the grip laid the tail straight ahead and let go.
    """
    from wrod.deployment.fixtures import Fixtures
    from wrod.solvers.friction import Friction

    planned.check()
    rod, curve = rod_options.read(), reading.read(pattern)
    Friction(laying.friction, laying.kinetic, laying.rolling)  # refused before it is planned
    file = laying.fixtures_file
    fixtures = None if file is None else Fixtures.load(file)
    given = rod
    path, curve, rod = planned.path(curve, rod, device)
    whole = given.length > rod.length
    laying.settle(path, device)
    deployments = laying.lay(curve, rod, path, fixtures, device, planned.another_rod, whole)
    written = _write(out, laying, deployments, path, curve, rod, fixtures)
    placed = None
    if fixtures is not None:
        placed = [
            fixtures.judge(d.released_centerline, rod.radius, d.released_speed) for d in deployments
        ]
    figures = {
        "pattern": curve.name,
        "method": path.method,
        "beyond_grip": path.beyond_grip,
        "friction": {
            "static": laying.friction,
            "kinetic": laying.kinetic or laying.friction,
            "rolling": laying.rolling,
        },
        "trials": [
            _figures(d, None if placed is None else placed[k])
            | ({"lies_beyond": _lying(d, rod)} if whole else {})
            for k, d in enumerate(deployments)
        ],
        "written": [str(name) for name in written],
    }
    tell(
        figures,
        *(
            f"trial {k}: "
            + ("diverged; the last good state is " if d.diverged else "")
            + f"{100 * d.error_mean:.3f} ± {100 * d.error_std:.3f} cm with the grip holding, "
            f"{100 * d.released_error_mean:.3f} ± {100 * d.released_error_std:.3f} cm let go; "
            f"largest slip {100 * d.slip.max():.2f} cm"
            + (
                f"; of {path.beyond_grip:.3f} m beyond the grip {_lying(d, rod):.3f} m are on the "
                "table"
                if whole
                else ""
            )
            + ("" if placed is None else f"; {placed[k]}")
            for k, d in enumerate(deployments)
        ),
    )


def _lying(deployment, rod) -> float:
    """How much of what is beyond the grip is on the table while that still holds [m]: from where
    it first touches."""
    s = deployment.arc_length
    touched = (s > rod.length) & deployment.contact_force.any(axis=1)
    return float(s[-1] - s[touched.argmax()]) if touched.any() else 0.0


def _write(out: Path, laying: Laying, deployments: list, path, curve, rod, fixtures) -> list[Path]:
    """Write the deployments, their picture, and the page of one."""
    from wrod.deployment.picture import draw_deployments

    title = f"{curve.name} · {path.method or ''} · friction {laying.friction:g}"
    names = ["deployment"]
    if laying.trials > 1:
        names = [f"deployment-{k}" for k in range(laying.trials)]
    kept = deployments
    if laying.frames is None:  # they were for the page alone
        kept = [replace(d, frames=None, hand=None) for d in deployments]
    written = [d.save(out / name) for d, name in zip(kept, names, strict=True)]
    written.append(draw_deployments(out / "deployment.png", curve, kept, title, fixtures))
    seen = deployments[0]
    if laying.paged and seen.frames is not None and len(seen.frames) > 1:
        from wrod.scene.page import write_laying_page

        page = out / "deployment.html"
        written.append(write_laying_page(page, seen, path, curve, rod, laying.interval))
    return written


def _figures(deployment, placed) -> dict:
    """What one trial came to, with the gates that it went through where there are any."""
    own = {
        "error_mean": deployment.error_mean,
        "error_std": deployment.error_std,
        "released_error_mean": deployment.released_error_mean,
        "released_error_std": deployment.released_error_std,
        "largest_slip": float(deployment.slip.max()),
        "diverged": deployment.diverged,
    }
    if placed is None:
        return own
    return own | {
        "placed": placed.placed,
        "gates": placed.gates.tolist(),
        "released_speed": deployment.released_speed,
        "penetration": deployment.penetration,
    }
