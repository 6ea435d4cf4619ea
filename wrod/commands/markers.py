"""`wrod markers`: the sheet of markers to print, which gives photographs their scale."""

from pathlib import Path

import click

from wrod.telling import json_option, tell


@click.command(
    name="markers", short_help="Write a sheet of markers to print, which gives pictures a scale."
)
@click.option(
    "--paper", default="a4", show_default=True, help="a4, a3, letter, or WIDTHxHEIGHT [m]."
)
@click.option("--side", default=0.024, show_default=True, help="Of a marker [m].")
@click.option("--margin", default=0.008, show_default=True, help="White edge of the sheet [m].")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@json_option
def command(paper: str, side: float, margin: float, out: Path) -> None:
    """Write a sheet of four ArUco markers to print, and the layout that photographs are read by.

    Draw on the printed sheet, or lay it beside what is photographed; then
    `wrod plan photo.jpg --markers OUT/layout.json` knows the picture's scale.
    """
    from wrod.commands.scan import parse_numbers
    from wrod.perception.sheet import PAPERS, MarkerSheet

    size = PAPERS.get(paper.lower())
    if size is None:
        width, height = parse_numbers(paper, 2, "--paper", "x")
        size = (width, height)
    sheet = MarkerSheet(size, side, margin)
    written = sheet.save(out)
    tell(
        sheet.layout() | {"span": sheet.span, "written": [str(path) for path in written]},
        f"four markers of {1e3 * side:g} mm on {1e3 * size[0]:g} x {1e3 * size[1]:g} mm; print "
        "markers.pdf at 100 %: outer edges of two markers side by side are then "
        f"{1e3 * sheet.span:.1f} mm apart",
    )
