"""From pictures to metres: markers, scale, orientation, the synthetic camera, and bad pictures."""

import io
import json
import time

import cv2
import numpy as np
import pytest
from cli import done, refused, run
from PIL import Image
from scipy.spatial import cKDTree
from top_camera import TopCamera

import wrod
from wrod.errors import PerceptionError
from wrod.patterns.curve import arc_length
from wrod.perception import refine
from wrod.perception.image import read_image
from wrod.perception.measure import compare
from wrod.perception.metric import CameraIntrinsics, MarkerLayout, SeenPlane
from wrod.perception.scan import oriented, read_scan

WIDTH, HEIGHT = 0.297, 0.21


def square(x, y, side=0.024):
    return [[x, y + side], [x + side, y + side], [x + side, y], [x, y]]


LAYOUT = {
    "paper_size_m": [WIDTH, HEIGHT],
    "dictionary": "DICT_4X4_50",
    "marker_corners_m": {
        "0": square(0.008, 0.178),
        "1": square(0.265, 0.178),
        "2": square(0.265, 0.008),
        "3": square(0.008, 0.008),
    },
}


@pytest.fixture
def layout(tmp_path):
    file = tmp_path / "layout.json"
    file.write_text(json.dumps(LAYOUT))
    return MarkerLayout.load(file)


@pytest.fixture
def camera():
    return TopCamera(
        (0.16, 0.06, 0.42), (WIDTH / 2, HEIGHT / 2, 0.0), size=(1280, 960), focal_length=1400.0
    )


def wave(n=2000):
    x = np.linspace(0.05, 0.24, n)
    return np.column_stack([x, 0.105 + 0.04 * np.sin(2 * np.pi * (x - 0.05) / 0.12)])


def loop(n=4000):
    t = np.linspace(-1.3, 1.3, n)
    return np.column_stack([0.15 + 0.045 * (t**3 - t), 0.06 + 0.05 * t**2])


_drawn: dict[tuple, np.ndarray] = {}


def drawing(camera, layout, *curves, **options):
    """Each picture is rendered once."""
    options = {"color": (30, 40, 120), "table": (120, 90, 60), "noise": 2.0} | options
    key = (camera.position, camera.target, camera.size, camera.focal_length, str(options))
    key += (str(layout), *(np.asarray(c).tobytes() for c in curves))
    if key not in _drawn:
        flat = [np.column_stack([c, np.zeros(len(c))]) for c in curves]
        _drawn[key] = camera.render(flat, 0.0006, layout=layout, **options)
    return _drawn[key].copy()


def mean_distance(points, truth):
    (a,), (b,) = refine.resample(points, 2e-5), refine.resample(truth, 2e-5)
    return np.r_[cKDTree(a).query(b)[0], cKDTree(b).query(a)[0]].mean()


@pytest.mark.parametrize("curve", [wave(), loop()], ids=["wave", "loop"])
def test_drawn_curve_is_recovered_in_metres(camera, layout, curve):
    pattern = wrod.scan(drawing(camera, layout, curve), markers=layout)
    position = pattern.sample(np.linspace(0, pattern.length, 2000))[0][:, :2]
    assert mean_distance(position, curve) < 7e-5
    assert pattern.length == pytest.approx(arc_length(curve)[-1], rel=0.005)
    assert np.hypot(*(position[0] - curve[0])) < 1e-3  # the end nearest the lower left corner


def test_deployed_rod_is_measured_through_the_camera():
    # pattern -> known deployed rod -> picture -> measured error
    points = wave()
    pattern = wrod.Pattern.from_points(wave(200))
    deployed = points + [0.003, 0.0]
    camera = TopCamera.above(points)
    picture = camera.render(np.column_stack([deployed, np.full(len(points), 0.0016)]), 0.0016)
    (line,) = wrod.trace_centerlines(picture)
    plane = SeenPlane(camera.homography(height=0.0016))
    assert mean_distance(plane.to_metres(line.points), deployed) < 3e-4
    measured = compare(plane.to_metres(line.points), pattern)
    assert measured.error_mean == pytest.approx(0.003, abs=3e-4)
    assert measured.error_std < 3e-4
    assert measured.deployed_length == pytest.approx(pattern.length, rel=0.005)


def test_measure_deployment_reads_markers_and_draws(camera, layout, tmp_path):
    picture = drawing(camera, layout, wave())
    shifted = wrod.Pattern.from_points(wave(200) + [0.0, 0.002])
    measured = wrod.measure_deployment(
        picture, shifted, markers=layout, picture=tmp_path / "error.png"
    )
    assert measured.error_mean == pytest.approx(0.002, abs=1e-4)
    assert len(measured.errors) == 50
    assert read_image(tmp_path / "error.png").shape[2] == 3


def test_rod_on_a_dark_table_between_markers(camera, layout):
    table = MarkerLayout(layout.corners)  # markers laid on the table, no sheet
    rod = np.column_stack([wave(), np.zeros(len(wave()))])
    picture = camera.render(rod, 0.0016, layout=table, table=(60, 60, 60), color=(220, 120, 140))
    measured = wrod.measure_deployment(picture, wrod.Pattern.from_points(wave(200)), markers=table)
    assert measured.error_mean < 3e-4


def test_colour_tells_a_rod_from_a_table_of_grained_wood_in_uneven_light():
    """The table is darker at one side, and in its grain, by more than a green rod is."""
    row, column = np.mgrid[:500, :800]
    grain = 12.0 * np.sin(row / 9.0 + 3.0 * np.sin(column / 210.0))
    curve = loop() / 5e-4  # [px], one crossing
    ink = np.zeros((500, 800), np.uint8)
    line = np.round(16 * np.column_stack([curve[:, 0], 499.0 - curve[:, 1]])).astype(np.int32)
    cv2.polylines(ink, [line], False, 255, 7, cv2.LINE_AA, shift=4)
    share = ink[..., None] / 255.0
    picture = (1.0 - share) * ([185.0, 150.0, 110.0] + grain[..., None]) + share * [60, 150, 60]
    picture *= (1.0 - 0.35 * column / 800.0)[..., None]
    picture += np.random.default_rng(0).normal(0.0, 4.0, picture.shape)
    picture = np.clip(picture, 0, 255).astype(np.uint8)
    with pytest.raises(PerceptionError, match="or the table not plain"):
        wrod.scan(picture, scale=5e-4)
    found = wrod.scan(picture, scale=5e-4, color=(60, 150, 60))
    assert mean_distance(found.sample(np.linspace(0, found.length, 2000))[0][:, :2], loop()) < 1e-4


def test_metric_follows_the_paper():
    # Eq. metric: N = 50 points by arc length, mean and deviation of their distances.
    line = np.column_stack([np.linspace(0, 1, 11), np.zeros(11)])
    tilted = np.column_stack([line[:, 0], 0.1 * line[:, 0]])
    measured = compare(tilted[::-1], line)
    share = np.linspace(0, 1, 50)
    errors = np.hypot(0.0, 0.1) * share
    assert measured.error_mean == pytest.approx(errors.mean(), rel=1e-9)
    assert measured.error_std == pytest.approx(errors.std(), rel=1e-9)


def test_upper_rod_covers_the_lower_one():
    t = np.linspace(-0.05, 0.05, 200)
    low = np.column_stack([t, t, np.full(200, 0.002)])
    high = np.column_stack([t, -t, np.full(200, 0.006)])
    camera = TopCamera((0, 0, 0.3), size=(400, 400), focal_length=900.0)
    colors = []
    for order in ([low, high], [high, low]):
        colors.append(camera.render(order, 0.002))
    assert np.array_equal(*colors)  # the order of drawing does not matter, height does


def test_camera_homography_inverts_its_projection(camera):
    points = np.random.default_rng(0).uniform(0.0, 0.2, (20, 2))
    for height in (0.0, 0.01):
        pixels = camera.project(np.column_stack([points, np.full(20, height)]))
        assert np.allclose(
            SeenPlane(camera.homography(height)).to_metres(pixels), points, atol=1e-12
        )


def test_distorted_picture_needs_its_camera(camera, layout, tmp_path):
    lens = {"camera_matrix": camera.matrix.tolist(), "distortion": [-0.25, 0.08, 0, 0, 0]}
    (tmp_path / "camera.json").write_text(json.dumps(lens))
    loaded = CameraIntrinsics.load(tmp_path / "camera.json")
    width, height = camera.size
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
    straight = loaded.undistort(grid).astype(np.float32).reshape(height, width, 2)
    bent = cv2.remap(
        drawing(camera, layout, wave()), straight[..., 0], straight[..., 1], cv2.INTER_LINEAR
    )
    result = read_scan(bent, markers=layout, camera=tmp_path / "camera.json")
    assert mean_distance(result.metric_lines()[0], wave()) < 7e-5


def test_sheet_and_scale_give_metres(layout):
    camera = TopCamera((WIDTH / 2, HEIGHT / 2, 0.5), (WIDTH / 2, HEIGHT / 2, 0), focal_length=1500)
    sheet = MarkerLayout({0: layout.corners[0]}, (WIDTH, HEIGHT))
    picture = drawing(camera, MarkerLayout({}, sheet.paper), wave())
    pattern = wrod.scan(picture, sheet=(WIDTH, HEIGHT))
    position = pattern.sample(np.linspace(0, pattern.length, 2000))[0][:, :2]
    assert mean_distance(position, wave()) < 2e-4
    scaled = wrod.scan(picture[200:-200, 250:-250], scale=0.5 / 1500)
    assert scaled.length == pytest.approx(arc_length(wave())[-1], rel=0.005)


def test_a_scale_in_millimetres_is_refused():
    with pytest.raises(PerceptionError, match=r"picture 200 m wide.*check the scale's unit"):
        wrod.scan(np.full((600, 800), 255, np.uint8), scale=0.25)


def test_a_sheet_is_found_with_a_shadow_over_its_edge(layout):
    camera = TopCamera((WIDTH / 2, HEIGHT / 2, 0.5), (WIDTH / 2, HEIGHT / 2, 0), focal_length=1500)
    picture = drawing(camera, MarkerLayout({}, (WIDTH, HEIGHT)), wave(), table=(150, 125, 95))
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    shade = 1.0 / (1.0 + np.exp(-(columns - 0.72 * picture.shape[1]) / 12.0))
    shade *= 1.0 / (1.0 + np.exp(-(rows - 0.45 * picture.shape[0]) / 12.0))
    shaded = (picture * (1.0 - 0.45 * shade)[..., None]).astype(np.uint8)
    pattern = wrod.scan(shaded, sheet=(WIDTH, HEIGHT))
    position = pattern.sample(np.linspace(0, pattern.length, 2000))[0][:, :2]
    assert mean_distance(position, wave()) < 2e-4


def test_start_is_a_corner_a_point_or_a_dot(camera, layout):
    curve = wave()
    dot = curve[-1] + [0.012, 0.0]
    ring = dot + 0.0008 * np.column_stack(
        [np.cos(np.linspace(0, 7, 60)), np.sin(np.linspace(0, 7, 60))]
    )
    picture = drawing(camera, layout, curve, ring)
    result = read_scan(picture, markers=layout)
    assert len(result.lines) == 1
    for start, end in (("lower-left", 0), ("upper-right", -1), ("dot", -1), (tuple(curve[-1]), -1)):
        assert np.hypot(*(oriented(result, start)[0] - curve[end])) < 1e-3
    with pytest.raises(PerceptionError, match="0 dots"):
        wrod.scan(drawing(camera, layout, curve), markers=layout, start="dot")
    with pytest.raises(PerceptionError, match="start"):
        oriented(result, "north")


def test_two_curves_where_one_is_wanted(camera, layout):
    picture = drawing(camera, layout, wave(), wave()[400:1000] + [0.0, 0.055])
    with pytest.raises(PerceptionError, match="2 curves"):
        wrod.scan(picture, markers=layout)


def test_a_line_that_turns_back_in_a_point_is_not_called_two_without_saying_so(camera, layout):
    turn = np.linspace(1.2, 4.0 * np.pi - 1.2, 900)
    cycloid = [0.02, 0.08] + 0.02 * np.column_stack([turn - np.sin(turn), 1.0 - np.cos(turn)])
    with pytest.raises(
        PerceptionError, match=r"round the sharp point, .*, at \(\d+, \d+\), or cover"
    ):
        wrod.scan(drawing(camera, layout, cycloid), markers=layout)


def test_a_stroke_seen_obliquely_is_explained_whole(layout):
    """It is twice as thick in front as at the back, and all of it is the stroke's."""
    low = TopCamera(
        (0.16, -0.1, 0.11), (WIDTH / 2, 0.1, 0.0), size=(1920, 1280), focal_length=900.0
    )
    angle = np.linspace(-1.0, np.pi + 1.0, 900)
    arc = np.column_stack([0.15 + 0.1 * np.cos(angle), 0.1 + 0.08 * np.sin(angle)])
    flat = np.column_stack([arc, np.zeros(len(arc))])
    found = read_scan(
        low.render([flat], 0.0012, layout=layout, color=(30, 40, 120)), markers=layout
    )
    line = found.single()
    assert line.half_width.max() > 2.0 * line.half_width.min()
    assert line.area == pytest.approx(np.count_nonzero(found.mask), rel=0.02)
    assert mean_distance(found.metric_lines()[0], arc) < 5e-5


def test_missing_and_doubled_markers_are_named(camera, layout):
    three = MarkerLayout({i: layout.corners[i] for i in (0, 1, 2)}, layout.paper)
    with pytest.raises(PerceptionError, match="marker 3 is not in the picture"):
        wrod.scan(drawing(camera, three, wave()), markers=layout)
    bare = MarkerLayout({}, layout.paper)
    with pytest.raises(PerceptionError, match="no marker"):
        wrod.scan(drawing(camera, bare, wave()), markers=layout)
    picture = drawing(camera, layout, wave())
    corner = np.round(camera.project(np.column_stack([layout.corners[0], np.zeros(4)])))
    x, y = (corner.min(0) - 8).astype(int)
    w, h = (corner.max(0) - corner.min(0) + 16).astype(int)
    picture[400 : 400 + h, 600 : 600 + w] = picture[y : y + h, x : x + w]
    with pytest.raises(PerceptionError, match="marker 0 is in the picture twice"):
        wrod.scan(picture, markers=layout)


def test_foreign_layout_is_refused(camera, layout, tmp_path):
    moved = json.loads(json.dumps(LAYOUT))
    moved["marker_corners_m"]["2"] = square(0.2, 0.03)
    (tmp_path / "moved.json").write_text(json.dumps(moved))
    with pytest.raises(PerceptionError, match="off their layout"):
        wrod.scan(drawing(camera, layout, wave()), markers=tmp_path / "moved.json")
    for text in ("{", "[]", '{"marker_corners_m": {"0": [[0, 0]]}}', "{}"):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(PerceptionError, match=r"bad\.json"):
            MarkerLayout.load(tmp_path / "bad.json")


def test_scale_is_asked_for(camera, layout):
    with pytest.raises(PerceptionError, match="no scale"):
        wrod.scan(drawing(camera, layout, wave()))
    with pytest.raises(PerceptionError, match="one only"):
        wrod.scan(drawing(camera, layout, wave()), markers=layout, scale=1e-3)


def test_pictures_are_upright_and_16_bit_is_read(tmp_path):
    grey = np.full((40, 60), 10, np.uint8)
    grey[5:10, 20:50] = 200
    Image.fromarray(grey.astype(np.uint16) * 256).save(tmp_path / "deep.png")
    deep = read_image(tmp_path / "deep.png")
    assert deep.dtype == np.uint8 and deep[7, 30] == 255 and deep[30, 30] < 20
    turned = Image.fromarray(np.rot90(grey, 1))
    exif = turned.getexif()
    exif[0x0112] = 6  # stored turned, to be shown a quarter turn clockwise
    turned.save(tmp_path / "turned.png", exif=exif)
    assert np.array_equal(read_image(tmp_path / "turned.png"), grey)


def test_damaged_files_are_refused(tmp_path, camera, layout):
    stream = io.BytesIO()
    Image.fromarray(drawing(camera, layout, wave())).save(stream, "JPEG")
    (tmp_path / "cut.jpg").write_bytes(stream.getvalue()[:20000])
    (tmp_path / "text.png").write_text("no picture")
    for name, message in (
        ("cut.jpg", "truncated"),
        ("text.png", "not a picture"),
        ("no.png", "no"),
    ):
        with pytest.raises(PerceptionError, match=message):
            read_image(tmp_path / name)


# ------------------------------------------------------------------ command line
def scanned(*arguments):
    return run("scan", *arguments)


def test_command_writes_paths_and_metres(tmp_path, camera, layout):
    Image.fromarray(drawing(camera, layout, loop())).save(tmp_path / "loop.png", compress_level=1)
    result = scanned(
        tmp_path / "loop.png", "--markers", tmp_path / "layout.json", "--out", tmp_path / "o"
    )
    assert result.exit_code == 0, result.output
    assert "1 curve" in result.output and "1 crossing" in result.output
    with np.load(tmp_path / "o" / "loop.npz") as data:
        assert data["paths"].shape[1] == 2 and data["path_start"].tolist() == [0]
        assert data["labels"].shape == (960, 1280)
        assert len(data["radius_px"]) == 1
        assert mean_distance(data["path_m"], loop()) < 7e-5
        assert len(data["crossings"]) == 1
    assert read_image(tmp_path / "o" / "loop-overlay.png").shape[2] == 3
    pattern = wrod.Pattern.from_points(loop())
    laid = wrod.load_laid([tmp_path / "o" / "loop.npz"], pattern, noise=1e-4)
    assert mean_distance(laid.curves[0], loop()) < 7e-5
    again = wrod.Pattern.load(tmp_path / "o" / "loop.npz")
    assert again.length == pytest.approx(pattern.length, rel=5e-3)


def test_command_scans_the_good_pictures_and_names_the_bad(tmp_path):
    mask = np.zeros((200, 300), np.uint8)
    cv2.line(mask, (20, 20), (270, 170), 255, 9)
    Image.fromarray(mask).save(tmp_path / "good.png")
    Image.fromarray(0 * mask).save(tmp_path / "blank.png")
    result = scanned(
        tmp_path / "blank.png", tmp_path / "good.png", "--mask", "--out", tmp_path / "o"
    )
    assert result.exit_code == 2
    assert "blank.png" in result.output and "Traceback" not in result.output
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["good-overlay.png", "good.npz"]


def test_plan_takes_a_picture(tmp_path, camera, layout):
    x = np.linspace(0.05, 0.24, 400)
    bow = np.column_stack([x, 0.08 + 3.0 * (x - 0.145) ** 2])
    Image.fromarray(drawing(camera, layout, bow)).save(tmp_path / "bow.png", compress_level=1)
    rod = ["--rod", "green-vps", "--spacing", "0.05", "--no-robot", "--no-expect"]
    rod += ["--out", str(tmp_path / "plan")]
    markers = ["--markers", str(tmp_path / "layout.json"), "--start", "lower-right"]
    done("plan", tmp_path / "bow.png", *markers, *rod)
    trajectory = wrod.Trajectory.load(tmp_path / "plan" / "trajectory.npz")
    assert np.hypot(*(trajectory.contact[-1, :2] - bow[0])) < 1.5e-3
    refused("picture", "plan", "letter-U", *markers, *rod)


def test_published_drawings_within_a_tenth_of_a_millimetre(shared):
    folder = shared / "images" / "drawn"
    for file in sorted((folder / "images").glob("*.jpg")):
        result = read_scan(file, markers=folder / "layout.json")
        (points,) = result.metric_lines()
        with np.load(folder / "gt" / f"{file.stem}.npz", allow_pickle=True) as truth:
            assert mean_distance(points, truth["path_m"]) < 7e-5, file.stem


def test_published_photographs_have_the_right_strands(shared):
    from wrod.perception.score import score_paths

    for name, least in (("S1", 0.970), ("S2", 0.962), ("S3", 0.962)):
        folder = shared / "images" / "dlo" / name
        crossings = json.loads((folder / "crossings.json").read_text())
        scores = []
        for file in sorted((folder / "gt").glob("*.png"))[::3]:
            labels = read_image(file)
            scores.append(
                score_paths(wrod.trace_centerlines(labels > 0), labels, crossings[file.stem])
            )
        for key in ("count", "order"):
            assert np.mean([score[key] for score in scores]) == 1.0
        assert np.mean([score["dice"] for score in scores]) >= least
        assert np.mean([score["offset_px"] for score in scores]) <= 0.22


def test_a_very_wide_picture_is_read():
    """OpenCV's median counts no more pixels than 255 across."""
    image = np.full((16, 36_000), 255, np.uint8)
    image[0, :2] = 240, 250  # no mask of two values
    with pytest.raises(PerceptionError, match="the picture is blank"):
        read_scan(image)


def test_black_on_white_is_ink_and_labels_are_a_mask():
    image = np.full((240, 320), 255, np.uint8)
    image[118:123, 40:280] = 0
    drawn = read_scan(image, kind="ink").single()
    assert drawn.length == pytest.approx(240, abs=5)
    for other in (read_scan(image), read_scan((image == 0).astype(np.uint8), mask=True)):
        assert other.single().length == pytest.approx(drawn.length, abs=2)


def test_textures_are_refused_before_they_are_paired():
    noise = np.random.default_rng(0).random((1000, 1000)) < 0.3
    grid = np.zeros((1000, 1000), bool)
    grid[np.arange(1000) % 12 < 3], grid[:, np.arange(1000) % 12 < 3] = True, True
    for texture in (noise, grid, np.kron(noise[:500, :500], np.ones((4, 4), bool))):
        start = time.process_time()
        with pytest.raises(PerceptionError, match=r"texture|cover less"):
            read_scan(texture, mask=True)
        assert time.process_time() - start < 10.0
