"""`wrod markers`: the sheet of markers to print, which gives photographs their scale."""

from pathlib import Path

import click

from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(
    name="markers", short_help="Write a sheet of markers to print, which gives pictures a scale."
)
@own_options
@json_option
def command(
    paper: str = option("a4, a3, letter, or WIDTHxHEIGHT [m].", default="a4"),
    side: float = option("Of a marker [m].", default=0.024),
    margin: float = option("White edge of the sheet [m].", default=0.008),
    out: Path = option(None, type=FOLDER, required=True),
) -> None:
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
