"""`wrod measure`: a rod's stiffness from an overhanging end, or from how it hangs as a loop."""

from pathlib import Path

import click

from wrod.commands.options import PICTURE, UNITS, PatternOptions
from wrod.errors import DataError, RodError
from wrod.options import FILE, gathered, option, own_options, refuse_idle_options
from wrod.telling import asked, json_option, tell


@click.command(
    name="measure", short_help="Measure a rod: a table's edge and a ruler, or a photograph."
)
@click.argument("curve", required=False)
@own_options
@gathered("picture", PatternOptions, UNITS, PICTURE)
@json_option
def command(
    curve: str | None,
    picture: PatternOptions,
    overhang: float | None = option("Length of rod beyond the table's edge [m]."),
    fall: float | None = option("Of its end below the clamped part [m]."),
    reading: float = option("Error of the ruler [m].", default=1e-3),
    radius: float = option("Radius of the section [m].", required=True),
    length: float = option("Total length of the rod [m].", required=True),
    density: float = option("Density [kg/m^3].", default=1180.0),
    out: Path | None = option("Rod file (.json) to write; `wrod plan --rod` reads it.", type=FILE),
) -> None:
    """Measure a rod's gravito-bending length with a ruler or a photograph.

    With a ruler: press the rod flat on a table so that it leaves the edge level, and read how far
    its free end is over (--overhang, along the rod) and how far it falls (--fall). Best falls by
    half of what is over; turn the rod over and take the mean if it is bent by itself.

    With a photograph: hang the rod as a loop between two hands or nails, in a plane before a sheet
    of markers (`wrod markers`) that hangs plumb. CURVE is the picture, or a file of points of the
    loop with y up.

    A third way needs no edge and no camera: see `wrod loop`.
    """
    from wrod.rods.material import RodMaterial
    from wrod.rods.model_file import save_rod

    if (curve is None) == (overhang is None and fall is None):
        raise DataError("give either --overhang and --fall, or the picture of a hanging loop")
    if out is not None and out.suffix != ".json":
        raise RodError(f"{out}: is not a .json file name; `wrod plan --rod` knows rods by it")
    if overhang is not None and overhang >= length:
        raise DataError(f"--overhang {overhang:g} m is not less than --length {length:g} m")
    if curve is not None:
        refuse_idle_options("a hanging loop", "reading")
        found, way = _of_loop(curve, picture, length), "hanging loop"
    else:
        found, way = _of_overhang(overhang, fall, reading, picture), "overhanging end"
    rod = RodMaterial(radius, found.gravito_bending_length, length, density=density)
    # The stiffness goes with the cube of the length.
    share = 3.0 * found.error / found.gravito_bending_length
    figures = {
        "way": way,
        "gravito_bending_length": found.gravito_bending_length,
        "error": found.error,
        "bending_stiffness": rod.bending_stiffness,
        "bending_stiffness_error": share * rod.bending_stiffness,
        "warning": found.warning,
        "written": [] if out is None else [str(save_rod(rod, out))],
    }
    tell(
        figures,
        f"gravito-bending length  {100 * found.gravito_bending_length:.3f} "
        f"± {100 * found.error:.3f} cm ({way})",
        f"bending stiffness       {rod.bending_stiffness:.3g} ± {share * rod.bending_stiffness:.1g}"
        f" N m^2, with a density of {density:g} kg/m^3",
    )
    if found.warning and not asked("json"):
        click.echo(f"wrod: warning: {found.warning}", err=True)


def _of_overhang(overhang: float | None, fall: float | None, reading: float, picture):
    from wrod.identification.ruler import measure_overhang

    for name in picture.given:
        raise DataError(f"--{name} belongs to a picture of a hanging loop; leave it out")
    if overhang is None or fall is None:
        raise DataError("--overhang and --fall belong together; give both")
    return measure_overhang(overhang, fall, reading)


def _of_loop(curve: str, picture: PatternOptions, length: float):
    import numpy as np

    from wrod.identification.hanging_loop import measure_hanging_loop

    loop = picture.read(curve)
    if loop.length > 1.05 * length:
        raise DataError(
            f"{curve}: shows a loop of {loop.length:.3g} m, and the rod is --length {length:g} m; "
            "check the curve's units and scale"
        )
    return measure_hanging_loop(loop.sample(np.linspace(0.0, loop.length, 200))[0][:, :2])
