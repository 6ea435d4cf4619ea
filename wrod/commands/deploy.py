"""`wrod deploy PATTERN`: lay the rod in simulation and measure how well it lies."""

from __future__ import annotations

import json
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import (
    DEVICE,
    METHOD,
    ROD,
    UNITS,
    options,
    read_pattern,
    read_rod,
    refuse_idle_options,
)

# How far a trajectory's contacts may be from the pattern [m], and its rod from the one laid.
_SAME_PATTERN, _SAME_ROD = 2e-3, 0.01
_PAGE_INTERVAL = 0.25  # [s] between the states that the page shows


@click.command(name="deploy")
@click.argument("pattern")
@options(ROD)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option(
    "--trajectory",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Trajectory (.npz) that `wrod plan` wrote, instead of a new plan.",
)
@click.option(
    "--another-rod", is_flag=True, help="Lay another rod than that of the trajectory, on purpose."
)
@options(METHOD, UNITS)
@click.option("--friction", default=0.6, show_default=True, help="Static friction coefficient.")
@click.option("--kinetic", type=float, help="Kinetic friction coefficient; default: the static.")
@click.option(
    "--fixtures",
    "fixtures_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Scene file (.json) of posts and clips to lay the rod between.",
)
@click.option("--rolling", is_flag=True, help="Let the laid rod roll freely.")
@click.option("--trials", default=1, show_default=True, help="Disturbed trials; 1 is the ideal.")
@click.option("--speed", default=0.02, show_default=True, help="Speed of the contact [m/s].")
@click.option(
    "--release",
    default=0.05,
    show_default=True,
    help="Laid length at which the free end, held for 5 cm, is let go [m].",
)
@click.option("--frames", type=float, help="Keep the rod's states at this interval [s].")
@options(DEVICE)
@cost.force_option
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    pattern: str,
    rod_name: str | None,
    radius: float | None,
    lgb: float | None,
    length: float | None,
    out: Path,
    trajectory: Path | None,
    another_rod: bool,
    method: str,
    closure: str | None,
    units: str | None,
    friction: float,
    kinetic: float | None,
    fixtures_file: Path | None,
    rolling: bool,
    trials: int,
    speed: float,
    release: float,
    frames: float | None,
    device: str,
    as_json: bool,
    force: bool,
) -> None:
    """Lay a rod along PATTERN in simulation, and measure it.

    The free end's first 5 cm are held at first. The rod is measured at the end of the pattern with
    the grip holding, and again after the grip laid the tail straight ahead and let go.
    """
    from dataclasses import replace
    from importlib.util import find_spec

    from wrod.deployment.fixtures import Fixtures
    from wrod.deployment.picture import draw_deployments
    from wrod.deployment.setup import Disturbance, tail
    from wrod.deployment.simulate import Trial, simulate_deployments, with_remainder_of
    from wrod.errors import DataError, RodError
    from wrod.planning.plan import plan
    from wrod.planning.trajectory import Trajectory
    from wrod.solvers.contact import Friction

    paged = find_spec("viser") is not None and trials == 1
    interval = _PAGE_INTERVAL if frames is None and paged else frames
    if trials < 1:
        raise RodError(f"trials is {trials}; give 1 or more")
    if trajectory is not None:
        refuse_idle_options("--trajectory", "method", "closure")
    if method == "intuitive":
        refuse_idle_options("--method intuitive", "closure")
    rod, curve = read_rod(rod_name, radius, lgb, length), read_pattern(pattern, units)
    law = Friction(friction, kinetic, rolling)
    fixtures = None if fixtures_file is None else Fixtures.load(fixtures_file)
    if trajectory is None:
        path = plan(
            curve, rod, method, closure=closure, device=None if device == "auto" else device
        )
    else:
        path = Trajectory.load(trajectory)
        _refuse_another_plan(path, with_remainder_of(curve, path), rod, another_rod)
    curve = with_remainder_of(curve, path)
    rest = tail(curve, rod, path)
    cost.settle(
        cost.deployments(
            trials, rod.length, speed=speed, step=0.01, spacing=0.005, device=device
        ),
        f"{trials} deployments", out, "ask for fewer --trials or a larger --speed", force=force,
        quiet=as_json,
    )  # fmt: skip
    jobs = [
        Trial(
            curve,
            rod,
            path,
            law,
            Disturbance() if trials == 1 else Disturbance.random(seed),
            rest,
            fixtures,
        )
        for seed in range(trials)
    ]
    shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
    with cost.progress_bar(total=100, desc="laid", quiet=as_json, bar_format=shown) as bar:
        deployments = simulate_deployments(
            jobs,
            speed=speed,
            release=release,
            frame_interval=interval,
            device=device,
            progress=lambda fraction: bar.update(min(100 * fraction, bar.total - bar.n)),
        )
    title = f"{curve.name} · {path.metadata.get('method', '')} · friction {friction:g}"
    seen = deployments[0]
    if frames is None:  # they were for the page alone
        deployments = [replace(d, frames=None, hand=None) for d in deployments]
    try:
        names = ["deployment"] if trials == 1 else [f"deployment-{k}" for k in range(trials)]
        written = [d.save(out / name) for d, name in zip(deployments, names, strict=True)]
        picture = draw_deployments(out / "deployment.png", curve, deployments, title, fixtures)
        written.append(picture)
        if paged:
            from wrod.scene.page import write_laying_page

            page = out / "deployment.html"
            written.append(write_laying_page(page, seen, path, curve, rod, interval))
    except OSError as error:
        raise DataError(f"{out}: cannot be written ({error}); choose another --out") from None
    placed = (
        None
        if fixtures is None
        else [
            fixtures.judge(d.released_centerline, rod.radius, d.released_speed) for d in deployments
        ]
    )
    figures = {
        "pattern": curve.name,
        "method": path.metadata.get("method"),
        "friction": {"static": friction, "kinetic": kinetic or friction, "rolling": rolling},
        "trials": [
            {
                "error_mean": d.error_mean,
                "error_std": d.error_std,
                "released_error_mean": d.released_error_mean,
                "released_error_std": d.released_error_std,
                "largest_slip": float(d.slip.max()),
                "diverged": d.diverged,
                **(
                    {}
                    if placed is None
                    else {
                        "placed": placed[k].placed,
                        "gates": placed[k].gates.tolist(),
                        "released_speed": d.released_speed,
                        "penetration": d.penetration,
                    }
                ),
            }
            for k, d in enumerate(deployments)
        ],
        "written": [str(name) for name in written],
    }
    if as_json:
        click.echo(json.dumps(figures, indent=2))
        return
    for k, d in enumerate(deployments):
        click.echo(
            f"trial {k}: "
            + ("diverged; the last good state is " if d.diverged else "")
            + f"{100 * d.error_mean:.3f} ± {100 * d.error_std:.3f} cm with the grip holding, "
            f"{100 * d.released_error_mean:.3f} ± {100 * d.released_error_std:.3f} cm let go; "
            f"largest slip {100 * d.slip.max():.2f} cm"
            + ("" if placed is None else f"; {placed[k]}")
        )
    for name in written:
        click.echo(f"wrote {name}")


def _refuse_another_plan(path, curve, rod, another_rod: bool) -> None:
    """Refuse a trajectory that was planned for another pattern, or for another rod."""
    import numpy as np

    from wrod.errors import PatternError, RodError

    s = np.clip(path.pattern_arc_length, -curve.remainder_length, curve.length)
    apart = np.linalg.norm(curve.sample(s)[0] - path.contact, axis=1).max()
    apart = max(apart, abs(path.pattern_arc_length[-1] - curve.length))
    if apart > _SAME_PATTERN:
        raise PatternError(
            f"the trajectory is of {path.metadata.get('pattern', 'another pattern')}, up to "
            f"{apart:.3f} m from {curve.name}; give the pattern that it was planned for"
        )
    planned = path.metadata.get("rod")
    if planned is None or another_rod:
        return
    for name in ("length", "radius", "gravito_bending_length"):
        before, now = float(planned[name]), getattr(rod, name)
        if abs(now - before) > _SAME_ROD * before:
            raise RodError(
                f"the trajectory is of a rod whose {name} is {before:g} m, and this one's is "
                f"{now:g} m; give that rod, or --another-rod to lay this one all the same"
            )
