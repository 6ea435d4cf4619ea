"""A drawing becomes a pattern, and the pattern a plan."""

from pathlib import Path

import numpy as np
from _picture import panels, save
from PIL import Image, ImageDraw

import wrod

SCALE = 1500.0  # [px/m]


def draw(path: Path) -> Path:
    """A sheet with one pen stroke: an S of two bends."""
    s = np.linspace(0.0, 1.0, 400)
    points = np.column_stack([0.05 + 0.32 * s, 0.12 + 0.05 * np.sin(2 * np.pi * s)])
    fine = 4  # pixels drawn for one of the picture, as a lens blends them
    sheet = Image.new("RGB", (fine * 630, fine * 360), (245, 243, 238))
    stroke = [tuple(p) for p in fine * SCALE * points]
    ImageDraw.Draw(sheet).line(stroke, fill=(40, 44, 60), width=fine * 6, joint="curve")
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.resize((630, 360), Image.Resampling.BOX).save(path)
    return path


def main(out: str | Path = "out/examples") -> Path:
    picture = draw(Path(out) / "drawing.png")
    pattern = wrod.scan(picture, scale=1.0 / SCALE)
    print(f"{pattern.length:.3f} m of stroke")
    trajectory = wrod.plan(pattern, wrod.rod("pink-vps"))
    figure, axes = panels()
    line = pattern.sample(np.linspace(0.0, pattern.length, 400))[0]
    axes.plot(*line[:, :2].T, color="#0b5fa5", label="stroke")
    axes.plot(*trajectory.position[:, :2].T, color="#d9822b", label="grip, from above")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(frameon=False)
    return save(figure, out, "scan_a_drawing")


if __name__ == "__main__":
    main()
