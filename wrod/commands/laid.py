"""`wrod laid RODS... --pattern P`: what rods on the table say of the model that laid them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from wrod.commands.options import DEVICE, ROD, UNITS, options, read_pattern, read_rod
from wrod.rods.model_file import rod_as_json


@click.command(name="laid")
@click.argument("rods", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--pattern", required=True, help="What they were laid along.")
@click.option(
    "--trajectory",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="Trajectory (.npz) of `wrod plan` that laid them.",
)
@options(ROD, UNITS)
@click.option("--noise", type=float, help="Of a coordinate [m]; default: the rods' scatter.")
@click.option("--friction", default=0.6, show_default=True, help="Static friction coefficient.")
@click.option(
    "--holding", is_flag=True, help="Measured with the grip holding, not after it let go."
)
@click.option("--iterations", default=2, show_default=True, help="Steps of the fit; 0: residual.")
@click.option("--fit-friction", is_flag=True, help="Find the table's friction, too.")
@click.option("--table", type=click.Path(dir_okay=False, path_type=Path), help="Its file (.json).")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Fitted rod (.json).")
@options(DEVICE)
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    rods: tuple[Path, ...],
    pattern: str,
    trajectory: Path,
    rod_name: str | None,
    radius: float | None,
    lgb: float | None,
    length: float | None,
    units: str | None,
    noise: float | None,
    friction: float,
    holding: bool,
    iterations: int,
    fit_friction: bool,
    table: Path | None,
    out: Path | None,
    device: str,
    as_json: bool,
) -> None:
    """Compare laid RODS with their pattern, and explain the difference.

    RODS are scans (`wrod scan --out`), deployments (`wrod deploy`) or files of points, all laid by
    one trajectory. The residual is explained by simulated deployments with another natural
    curvature and another L_gb, with --fit-friction also with another friction.
    """
    from tqdm import tqdm

    from wrod.deployment.simulate import with_remainder_of
    from wrod.deployment.table import Table
    from wrod.errors import DataError
    from wrod.identification.laid.fit import fit_laid
    from wrod.identification.laid.measurements import load_laid
    from wrod.planning.trajectory import Trajectory

    if table is not None and not (fit_friction and iterations > 0):
        raise DataError("--table is for the friction found; add --fit-friction and iterations")
    if iterations == 0 and out is not None:
        raise DataError("--out is for the fitted rod, and --iterations 0 fits none; drop one")
    path = Trajectory.load(trajectory)
    curve = with_remainder_of(read_pattern(pattern, units), path)
    laid = load_laid(list(rods), curve, units=units, noise=noise)
    along, left = 1e3 * laid.residual().mean(axis=0).T
    figures = {
        "rods": [str(rod) for rod in rods],
        "noise_mm": 1e3 * laid.noise,
        "noise_floor_mm": 1e3 * laid.noise_floor,
        "from_pattern_mm": 1e3 * laid.rms(),
        "along_mm": along.tolist(),
        "left_mm": left.tolist(),
    }
    if iterations > 0:
        rod = read_rod(rod_name, radius, lgb, length)
        shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
        with tqdm(total=1.0, leave=False, desc="laid", disable=as_json, bar_format=shown) as bar:
            fit = fit_laid(
                laid, rod, path, friction, released=not holding, iterations=iterations,
                fit_friction=fit_friction,
                device=device,
                progress=lambda share: bar.update(min(share, bar.total - bar.n)),
            )  # fmt: skip
        figures |= {
            "verdict": fit.verdict,
            "reason": fit.reason,
            "before_mm": 1e3 * fit.before,
            "after_mm": 1e3 * fit.after,
            "alone_mm": {name: 1e3 * value for name, value in fit.alone.items()},
            "parameters": {name: asdict(value) for name, value in fit.estimates.items()},
            "rod": rod_as_json(fit.rod),
            "friction": fit.friction,
            "correlation": fit.correlation,
        }
        written = [] if out is None else [str(fit.rod.save(out))]
        if table is not None:
            error = fit.estimates["log_friction"].stderr
            found = Table(fit.friction, error, fit.correlation)
            written.append(str(found.save(table)))
        if written:
            figures["written"] = written
    if as_json:
        click.echo(json.dumps(figures, indent=2))
        return
    click.echo(
        f"{len(rods)} rods {figures['from_pattern_mm']:.2f} mm from the pattern (RMS), noise floor "
        f"{figures['noise_floor_mm']:.2f} mm; mean {along.mean():+.2f} mm along, "
        f"{left.mean():+.2f} mm to the left"
    )
    if iterations > 0:
        click.echo(f"{fit.verdict}: {fit.reason}")
        for name, value in fit.estimates.items():
            click.echo(f"  {name}: {value.value:.4g} ± {value.stderr:.2g} {value.unit}".rstrip())
        for name in figures.get("written", []):
            click.echo(f"wrote {name}")
