"""`wrod render SCENE`: pictures of a scene through its cameras, or a page for the browser."""

from pathlib import Path

import click

from wrod import cost
from wrod.errors import DataError
from wrod.options import option, own_options, refuse_idle_options


def _size(ctx, param, value: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in value.lower().split("x"))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not WIDTHxHEIGHT, like 960x720") from None
    return width, height


# Suffixes of what other programs draw.
_OTHERS = (
    ".jpg", ".jpeg", ".gif", ".tif", ".tiff", ".bmp", ".webp", ".svg", ".pdf", ".exr", ".mp4",
    ".mov", ".avi", ".mkv", ".webm", ".htm",
)  # fmt: skip


@click.command(name="render")
@click.argument("scene", type=click.Path(path_type=Path))
@own_options
@cost.force_option
def command(
    scene: Path,
    out: Path = option("Folder, PNG or HTML.", required=True),
    camera: str = option("top, work, perspective, ...", default="perspective"),
    frames: int | None = option("Pictures from first to last; 24, or 1 for a PNG."),
    moments: bool = option("One PNG of the scene's moments: knots and cables."),
    size: tuple[int, int] = option("Pixels.", default="960x720", callback=_size),
    hide: tuple[str, ...] = option("Leave out prims of this name (robot, ...)."),
) -> None:
    """Draw SCENE, a USD stage, without a display.

    A folder gets one PNG per frame; a .png the last one; a .html the whole deployment as a page
    that plays in any browser. --moments draws the stages of tying in one .png, from the cameras
    side and close.
    """
    from wrod.scene.render import draw_moments, render
    from wrod.scene.validate import open_stage
    from wrod.scene.view import write_page

    page = out.suffix.lower() == ".html"
    if not page and out.suffix.lower() in _OTHERS:
        raise DataError(f"{out}: pictures are .png, pages .html; name one, or a folder of pictures")
    if page:
        refuse_idle_options("a page", "frames", "size", "moments")
    elif moments:
        refuse_idle_options("--moments", "frames", "camera", "hide")
    open_stage(scene)  # refused before Newton is loaded, which takes seconds
    count = frames if frames is not None else (1 if out.suffix else 24)
    if not (page or moments):
        cost.settle(
            cost.pictures(count, *size), f"{count} pictures of {size[0]} x {size[1]} pixels",
            "give a smaller --size or fewer --frames",
        )  # fmt: skip
    with cost.progress_bar(unit="frame") as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        if moments:
            written = [draw_moments(scene, out, size=size, progress=progress)]
        elif page:
            written = [write_page(scene, out, camera=camera, hidden=hide, progress=progress)]
        else:
            written = render(
                scene,
                out,
                camera=camera,
                frames=count,
                size=size,
                hidden=hide,
                progress=progress,
            )
    for path in written:
        click.echo(f"wrote {path}")
