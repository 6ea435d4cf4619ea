"""`wrod loop`: the material of a rod from the height of its loop."""

from pathlib import Path

import click

from wrod.errors import RodError
from wrod.options import FILE, option, own_options
from wrod.telling import json_option, tell


@click.command(name="loop", short_help="Measure a rod: a fold on the table and a ruler.")
@own_options
@json_option
def command(
    height: float = option("Height of the loop's centreline [m].", required=True),
    radius: float = option("Radius of the section [m].", required=True),
    length: float = option("Total length of the rod [m].", required=True),
    density: float = option("Density [kg/m^3].", default=1180.0),
    poisson: float = option("Poisson's ratio.", default=0.5),
    out: Path | None = option("Rod file (.json) to write; `wrod plan --rod` reads it.", type=FILE),
) -> None:
    """Measure a rod: fold it over on the table and read how high the loop stands.

    The rod lies flat, lifts off, turns over by 180 degrees and lies flat again. HEIGHT is that of
    the centreline at the top above the centreline of the flat part: the outer height less one
    diameter.
    """
    from wrod.rods.material import LOOP_HEIGHT_RATIO, RodMaterial
    from wrod.rods.model_file import save_rod

    rod = RodMaterial.from_loop_height(height, radius, length, density=density, poisson=poisson)
    if out is not None:
        if out.suffix != ".json":
            raise RodError(f"{out}: is not a .json file name; `wrod plan --rod` knows rods by it")
        save_rod(rod, out)
    figures = {
        "loop_height_ratio": LOOP_HEIGHT_RATIO,
        "gravito_bending_length": rod.gravito_bending_length,
        "stretch_ratio": rod.stretch_ratio,
        "youngs_modulus": rod.youngs_modulus,
        "bending_stiffness": rod.bending_stiffness,
        "written": [] if out is None else [str(out)],
    }
    tell(
        figures,
        f"loop height             {LOOP_HEIGHT_RATIO:.5f} L_gb",
        f"gravito-bending length  {rod.gravito_bending_length * 100:.3f} cm",
        f"stretch ratio           {rod.stretch_ratio:.0f}",
        f"Young's modulus         {rod.youngs_modulus / 1e6:.3f} MPa",
        f"bending stiffness       {rod.bending_stiffness:.4g} N m^2",
    )
