"""`wrod laid RODS... --pattern P`: what rods on the table say of the model that laid them."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import DEVICE, UNITS, PatternOptions, RodOptions
from wrod.errors import DataError
from wrod.options import FILE, gathered, option, own_options
from wrod.telling import json_option, tell


@dataclass(frozen=True)
class _Fit:
    """What is fitted, and where it goes."""

    friction: float = option("Static friction coefficient.", default=0.6)
    holding: bool = option("Measured with the grip holding, not after it let go.")
    iterations: int = option("Steps of the fit; 0: residual.", default=2)
    fit_friction: bool = option("Find the table's friction, too.")
    table: Path | None = option("Its file (.json).", type=FILE)
    out: Path | None = option("Fitted rod (.json).", type=FILE)

    def check(self) -> None:
        """Refuse files of what is not fitted."""
        if self.table is not None and not (self.fit_friction and self.iterations > 0):
            raise DataError("--table is for the friction found; add --fit-friction and iterations")
        if self.iterations == 0 and self.out is not None:
            raise DataError("--out is for the fitted rod, and --iterations 0 fits none; drop one")

    def settle(self, path) -> None:
        """Say what the deployments cost that are simulated: at the end one, and for each step one
        and one for each parameter."""
        count = 1 + (4 if self.fit_friction else 3) * self.iterations
        length = float(path.arc_length[-1])
        work = cost.deployments(count, length, speed=0.02, step=0.01, spacing=0.005)
        cost.settle(work, f"{count} deployments", "ask for fewer --iterations")

    def run(self, laid, rod, path, device: str):
        """The `LaidFit`."""
        from wrod.identification.laid.fit import fit_laid

        with cost.share_bar("laid") as progress:
            return fit_laid(
                laid, rod, path, self.friction, released=not self.holding,
                iterations=self.iterations, fit_friction=self.fit_friction, device=device,
                progress=progress,
            )  # fmt: skip

    def save(self, found) -> list[str]:
        """Write the rod and the table that were asked for."""
        from wrod.deployment.table import TableFriction
        from wrod.rods.model_file import save_rod

        written = [] if self.out is None else [str(save_rod(found.rod, self.out))]
        if self.table is not None:
            error = found.estimates["log_friction"].stderr
            written.append(
                str(TableFriction(found.friction, error, found.correlation).save(self.table))
            )
        return written


@click.command(name="laid", short_help="Compare laid rods with their pattern.")
@click.argument("rods", nargs=-1, required=True, type=click.Path(path_type=Path))
@own_options
@gathered("rod_options", RodOptions)
@gathered("reading", PatternOptions, UNITS)
@gathered("fit", _Fit)
@DEVICE
@json_option
def command(
    rods: tuple[Path, ...],
    rod_options: RodOptions,
    reading: PatternOptions,
    fit: _Fit,
    device: str,
    pattern: str = option("What they were laid along.", required=True),
    trajectory: Path = option(
        "Trajectory (.npz) of `wrod plan` that laid them.", required=True, type=FILE
    ),
    noise: float | None = option("Of a coordinate [m]; default: the rods' scatter."),
) -> None:
    """Compare laid RODS with their pattern, and explain the difference.

    RODS are scans (`wrod scan --out`), deployments (folders of `wrod deploy`, or the .npz in them)
    or files of points, all laid by one trajectory. The residual is explained by simulated
    deployments with another natural curvature and another L_gb, with --fit-friction also with
    another friction.
    """
    from wrod.deployment.bounds import refuse_another_rod
    from wrod.deployment.simulate import with_remainder_of
    from wrod.identification.laid.measurements import load_laid
    from wrod.planning.hold import as_held
    from wrod.planning.trajectory import Trajectory
    from wrod.rods.model_file import rod_as_json

    fit.check()
    path = Trajectory.load(trajectory)
    if fit.iterations > 0:
        rod = as_held(path, rod_options.read())
        refuse_another_rod(path, rod, ("length", "radius"))
    curve = with_remainder_of(reading.read(pattern), path)
    laid = load_laid(list(rods), curve, units=reading.units, noise=noise, released=not fit.holding)
    along, left = 1e3 * laid.residual().mean(axis=0).T
    figures = {
        "rods": list(laid.names),
        "noise_mm": 1e3 * laid.noise,
        "noise_floor_mm": 1e3 * laid.noise_floor,
        "from_pattern_mm": 1e3 * laid.rms(),
        "along_mm": along.tolist(),
        "left_mm": left.tolist(),
    }
    if fit.iterations > 0:
        fit.settle(path)
        found = fit.run(laid, rod, path, device)
        figures |= {
            "verdict": found.verdict,
            "reason": found.reason,
            **found.errors(),
            "alone_mm": {name: 1e3 * value for name, value in found.alone.items()},
            "parameters": {name: asdict(value) for name, value in found.estimates.items()},
            "rod": rod_as_json(found.rod),
            "friction": found.friction,
            "correlation": found.correlation,
        }
        if written := fit.save(found):
            figures["written"] = written
    lines = [
        f"{len(laid.names)} rods {figures['from_pattern_mm']:.2f} mm from the pattern (RMS), "
        f"noise floor {figures['noise_floor_mm']:.2f} mm; mean {along.mean():+.2f} mm along, "
        f"{left.mean():+.2f} mm to the left"
    ]
    if fit.iterations > 0:
        lines.append(f"{found.verdict}: {found.reason}")
        lines += [_said(name, value, found) for name, value in found.estimates.items()]
    tell(figures, *lines)


def _said(name: str, estimate, found) -> str:
    """A parameter in words; of a logarithm the quantity, and how far it is from the given one."""
    if not name.startswith("log_"):
        return f"  {name}: {estimate} more than the given rod's to the left"
    size = f"{found.friction:.3f}"
    if name == "log_L_gb":
        size = f"{100 * found.rod.gravito_bending_length:.3f} cm"
    if estimate.stderr > 3.0:  # twenty times as large or as small
        return f"  {name.removeprefix('log_')}: {size}, of which the rods tell nothing"
    low, high = (100 * math.expm1(estimate.value + k * estimate.stderr) for k in (-1, 1))
    change = f"{(low + high) / 2:+.2f} ± {(high - low) / 2:.2g} %"
    return f"  {name.removeprefix('log_')}: {size}, {change} beside the given one"
