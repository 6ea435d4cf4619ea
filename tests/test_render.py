import numpy as np
import pytest
from cli import refused
from click.testing import CliRunner

import wrod
from wrod.commands import main
from wrod.errors import SceneError

pytest.importorskip("newton")
SIZE = (320, 240)


@pytest.fixture(scope="module")
def scene(tmp_path_factory, letter, letter_path):
    path = tmp_path_factory.mktemp("render") / "letter.usdc"
    return wrod.export_usd(
        path, trajectory=letter, joint_path=letter_path, rod=wrod.rod("green-vps")
    )


@pytest.fixture(scope="module")
def renderer(scene):
    from wrod.scene.render import Renderer

    return Renderer(scene, "top", SIZE, hidden=("robot", "grip_path"))


def pixels(stage, points, size):
    """Where a camera sees points (n, 3): columns and rows, from the camera's own attributes."""
    from pxr import UsdGeom

    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/top"))
    pose = np.array(camera.ComputeLocalToWorldTransform(0)).T
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    focal, aperture = camera.GetFocalLengthAttr().Get(), camera.GetHorizontalApertureAttr().Get()
    scale = focal / aperture * size[0]
    column = size[0] / 2 + scale * local[:, 0] / -local[:, 2]
    row = size[1] / 2 - scale * local[:, 1] / -local[:, 2]
    return column.astype(int), row.astype(int)


def test_laid_rod_appears_where_the_camera_sees_it(renderer, letter):
    picture = renderer.frame(len(letter) - 1).astype(int)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    column, row = pixels(renderer.scene.stage, letter.contact[4:-20], SIZE)
    green = picture[..., 1] - picture[..., 0]  # the rod is green, the table is not
    hits = [
        green[r - 1 : r + 2, c - 1 : c + 2].max() > 15 for c, r in zip(column, row, strict=True)
    ]
    assert np.mean(hits) > 0.95
    table = green[SIZE[1] // 8 : SIZE[1] // 8 + 4, SIZE[0] // 8 : SIZE[0] // 8 + 4]
    assert table.max() < 10


def test_rod_grows_on_the_table(renderer, letter):
    seen = []
    column, row = pixels(renderer.scene.stage, letter.contact[30:70], SIZE)
    for code in (0, len(letter) - 1):
        picture = renderer.frame(code).astype(int)
        seen.append((picture[..., 1] - picture[..., 0])[row, column])
    assert np.median(seen[1]) > np.median(seen[0]) + 20


def test_command_draws_frames_and_stills(tmp_path, scene):
    run = CliRunner().invoke
    result = run(
        main,
        ["render", str(scene), "--camera", "top", "--frames", "2", "--size", "160x120"]
        + ["--out", str(tmp_path / "frames")],
    )
    assert result.exit_code == 0, result.output
    names = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert names == ["top_0000.png", "top_0184.png"]
    assert all(f"wrote {tmp_path / 'frames' / name}" in result.output for name in names)
    from matplotlib import image

    assert image.imread(tmp_path / "frames" / names[0]).shape[:2] == (120, 160)


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--camera", "left"], "no camera 'left'; its cameras are top, perspective, work"),
        (["--hide", "unicorn"], "no prim is named unicorn"),
        (["--frames", "0"], "0 is not in the range 1<=x<=10000"),
        (["--size", "0x9"], "picture size 0 x 9"),
    ],
)
def test_bad_requests_are_named(tmp_path, scene, arguments, says):
    refused(says, "render", scene, "--out", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


def test_missing_scene_and_several_frames_for_one_file(tmp_path, scene):
    from wrod.scene.render import render

    says = "gone.usdc: no such file"
    refused(says, "render", tmp_path / "gone.usdc", "--out", tmp_path / "a.png")
    with pytest.raises(SceneError, match="3 frames do not fit in one picture"):
        render(scene, tmp_path / "a.png", frames=3)
