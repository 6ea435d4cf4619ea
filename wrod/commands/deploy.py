"""`wrod deploy PATTERN`: lay the rod in simulation and measure how well it lies."""

from __future__ import annotations

import json
from pathlib import Path

import click

from wrod.commands.options import DEVICE, METHOD, ROD, UNITS, options, read_pattern, read_rod


@click.command(name="deploy")
@click.argument("pattern")
@options(ROD)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option(
    "--trajectory",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Trajectory (.npz) that `wrod plan` wrote, instead of a new plan.",
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
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    pattern: str,
    rod_name: str | None,
    radius: float | None,
    lgb: float | None,
    length: float | None,
    out: Path,
    trajectory: Path | None,
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
) -> None:
    """Lay a rod along PATTERN in simulation, and measure it.

    The free end's first 5 cm are held at first. The rod is measured at the end of the pattern with
    the grip holding, and again after the grip laid the tail straight ahead and let go.
    """
    from tqdm import tqdm

    from wrod.deployment.fixtures import Fixtures
    from wrod.deployment.picture import draw_deployments
    from wrod.deployment.setup import Disturbance, tail
    from wrod.deployment.simulate import Trial, simulate_deployments, with_remainder_of
    from wrod.errors import DataError, RodError
    from wrod.planning.plan import plan
    from wrod.planning.trajectory import Trajectory
    from wrod.solvers.contact import Friction

    refuse_ignored(trajectory, method, closure)
    if trials < 1:
        raise RodError(f"trials is {trials}; give 1 or more")
    rod, curve = read_rod(rod_name, radius, lgb, length), read_pattern(pattern, units)
    law = Friction(friction, kinetic, rolling)
    fixtures = None if fixtures_file is None else Fixtures.load(fixtures_file)
    if trajectory is None:
        path = plan(
            curve, rod, method, closure=closure, device=None if device == "auto" else device
        )
    else:
        path = Trajectory.load(trajectory)
        refuse_foreign(path, curve, rod, trajectory)
    curve = with_remainder_of(curve, path)
    rest = tail(curve, rod, path)
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
    with tqdm(
        total=100, leave=False, delay=1.0, desc="laid", disable=as_json, bar_format=shown
    ) as bar:
        deployments = simulate_deployments(
            jobs,
            speed=speed,
            release=release,
            frame_interval=frames,
            device=device,
            progress=lambda fraction: bar.update(min(100 * fraction, bar.total - bar.n)),
        )
    title = f"{curve.name} · {path.metadata.get('method', '')} · friction {friction:g}"
    try:
        names = ["deployment"] if trials == 1 else [f"deployment-{k}" for k in range(trials)]
        written = [d.save(out / name) for d, name in zip(deployments, names, strict=True)]
        picture = draw_deployments(out / "deployment.png", curve, deployments, title, fixtures)
        written.append(picture)
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


def refuse_ignored(trajectory: Path | None, method: str, closure: str | None) -> None:
    """Refuse options that a combination would ignore.

    Raises:
        GraspError: names them.
    """
    from wrod.errors import GraspError

    source = click.get_current_context().get_parameter_source("method")
    chosen = ["--method"] if source is click.core.ParameterSource.COMMANDLINE else []
    chosen += ["--closure"] if closure is not None else []
    if trajectory is not None and chosen:
        raise GraspError(
            f"{' and '.join(chosen)} belong to a new plan, and --trajectory is one already; drop "
            "the one or the other"
        )
    if method == "intuitive" and closure is not None:
        raise GraspError("--closure chooses among optimal grasps, and --method intuitive has none")


def refuse_foreign(path, curve, rod, name: Path) -> None:
    """Refuse a trajectory of another pattern or of another rod.

    Raises:
        DataError: says what differs, and by how much.
    """
    from dataclasses import fields

    import numpy as np

    from wrod.errors import DataError

    s = path.pattern_arc_length
    on = (s >= -1e-9) & (s <= curve.length + 1e-9)
    apart = abs(float(s[-1]) - curve.length)
    if on.any():
        position = curve.sample(np.clip(s[on], 0.0, curve.length))[0]
        apart = max(apart, float(np.linalg.norm(position - path.contact[on], axis=1).max()))
    if apart > 1e-3:
        raise DataError(
            f"{name}: is the trajectory of another pattern, {path.metadata.get('pattern')!r}: it "
            f"leaves {curve.name} by up to {100 * apart:.1f} cm; give the pattern that it was "
            "planned for"
        )
    planned = path.metadata.get("rod")
    if not isinstance(planned, dict):
        return
    for field in fields(rod):
        mine, theirs = getattr(rod, field.name), planned.get(field.name)
        if not (isinstance(mine, float) and isinstance(theirs, (int, float))):
            continue
        if abs(mine - theirs) > 1e-6 * max(abs(mine), abs(theirs)):
            raise DataError(
                f"{name}: was planned for another rod, whose {field.name} is {theirs:g} and not "
                f"{mine:g}; give that rod"
            )
