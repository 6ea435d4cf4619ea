"""Centrelines of drawn masks whose course is known."""

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

import wrod
from wrod.errors import PerceptionError
from wrod.patterns.curve import arc_length
from wrod.perception import refine
from wrod.perception.bridges import bending_energy
from wrod.perception.crossings import find_crossings
from wrod.perception.score import _draw
from wrod.perception.trace import Centerline

SIZE = (480, 640)


def spline(*corners, closed=False):
    corners = np.array(corners + corners[:1] if closed else corners, float)
    knots = np.r_[0.0, np.cumsum(np.sqrt(np.hypot(*np.diff(corners, axis=0).T)))]
    curve = CubicSpline(knots, corners, bc_type="periodic" if closed else "not-a-knot")
    return curve(np.linspace(0.0, knots[-1], 3000))


def draw(paths, radius, size=SIZE):
    fine = 4
    mask = np.zeros((size[0] * fine, size[1] * fine), np.uint8)
    for path in paths:
        points = np.round(((path + 0.5) * fine - 0.5) * 16).astype(np.int32)[:, None]
        cv2.polylines(mask, [points], False, 255, round(2 * radius * fine), cv2.LINE_8, shift=4)
    return cv2.resize(mask, size[::-1], interpolation=cv2.INTER_AREA) > 127


def nearest(line, truth):
    """Mean nearest distance both ways."""
    dense, true = (refine.resample(points, 0.1)[0] for points in (line.points, truth))
    return np.r_[cKDTree(dense).query(true)[0], cKDTree(true).query(dense)[0]].mean()


def ordered(line, truth):
    """The largest distance between points at the same share of the length, from either end."""
    share, curves = np.linspace(0.0, 1.0, 400), []
    for points in (line.points, truth):
        (dense,) = refine.resample(points, 0.1)
        curves.append(dense[np.round(share * (len(dense) - 1)).astype(int)])
    found, true = curves
    return min(np.hypot(*(way - true).T).max() for way in (found, found[::-1]))


SHAPES = {
    "arc": ([(60, 400), (200, 100), (420, 90), (580, 380)],),
    "loop": ([(40, 400), (300, 300), (420, 120), (300, 60), (220, 200), (560, 430)],),
    "two": ([(40, 60), (300, 200), (600, 420)], [(40, 430), (300, 260), (600, 50)]),
    "three in a bundle": (
        [(40, 240), (320, 230), (600, 250)],
        [(60, 60), (320, 240), (560, 440)],
        [(60, 430), (330, 250), (560, 40)],
    ),
}


@pytest.mark.parametrize("radius", [2.0, 4.0, 7.0])
@pytest.mark.parametrize("name", SHAPES)
def test_known_curves_are_found_to_a_fifth_of_a_pixel(name, radius):
    truth = [spline(*corners) for corners in SHAPES[name]]
    lines = wrod.trace_centerlines(draw(truth, radius))
    assert len(lines) == len(truth)
    for path in truth:
        line = min(lines, key=lambda one: ordered(one, path))
        assert nearest(line, path) < 0.2
        assert ordered(line, path) < 3.0
    for line in lines:
        assert line.radius == pytest.approx(radius, abs=0.3)


def test_length_has_no_staircase():
    truth = spline((40, 400), (300, 300), (420, 120), (300, 60), (220, 200), (560, 430))
    (line,) = wrod.trace_centerlines(draw([truth], 4.0))
    assert line.length == pytest.approx(arc_length(truth)[-1], rel=0.005)


def test_closed_curve_is_closed():
    truth = spline((320, 60), (560, 240), (330, 420), (120, 230), closed=True)
    (line,) = wrod.trace_centerlines(draw([truth], 5.0))
    assert line.closed
    assert np.allclose(line.points[0], line.points[-1])
    (dense,) = refine.resample(line.points, 0.1)
    assert cKDTree(dense).query(truth)[0].mean() < 0.2


def test_figure_eight_is_one_closed_curve():
    t = np.linspace(0, 2 * np.pi, 2000)
    truth = np.column_stack([320 + 240 * np.sin(t), 240 + 150 * np.sin(2 * t)])
    (line,) = wrod.trace_centerlines(draw([truth], 5.0))
    assert line.closed
    assert len(find_crossings([line])) == 1
    assert line.length == pytest.approx(arc_length(truth)[-1], rel=0.005)


def test_rod_that_leaves_the_picture_ends_on_its_border():
    truth = spline((-30, 200), (200, 150), (400, 300), (700, 260))
    (line,) = wrod.trace_centerlines(draw([truth], 6.0))
    ends = sorted(line.points[[0, -1], 0])
    assert ends[0] == pytest.approx(0.0, abs=1.5)
    assert ends[1] == pytest.approx(SIZE[1] - 1, abs=1.5)


def test_gap_is_bridged_and_distant_ends_are_not():
    left, right = (
        spline((40, 200), (150, 180), (280, 200)),
        spline((300, 205), (450, 240), (600, 200)),
    )
    assert len(wrod.trace_centerlines(draw([left, right], 5.0))) == 1
    far = spline((400, 330), (500, 350), (600, 330))
    assert len(wrod.trace_centerlines(draw([left, far], 5.0))) == 2


@pytest.mark.parametrize("touching", [True, False], ids=["touch", "cross"])
def test_near_parallel_strands(touching):
    x = np.linspace(30, 610, 1500)
    radius = 5.0
    bend = 90 * ((x - 320) / 290) ** 2 if touching else 90 * (x - 320) / 290
    shift = radius + 0.2 if touching else 0.0
    truth = [np.column_stack([x, 240 - shift - bend]), np.column_stack([x, 240 + shift + bend])]
    lines = wrod.trace_centerlines(draw(truth, radius))
    assert len(lines) == 2
    for path in truth:
        assert min(ordered(line, path) for line in lines) < 6.0
    assert len(find_crossings(lines)) == (0 if touching else 1)


def test_over_and_under_are_read_from_colours_and_from_edges():
    picture = np.full((*SIZE, 3), 20, np.uint8)
    under, over = spline((40, 60), (300, 200), (600, 420)), spline((40, 430), (300, 260), (600, 50))

    def stroke(path, color, radius=7):
        points = np.round(path * 16).astype(np.int32)[:, None]
        cv2.polylines(picture, [points], False, color, 2 * radius + 1, cv2.LINE_AA, shift=4)

    for colors in (((200, 60, 80), (90, 180, 70)), ((200, 60, 80), (200, 60, 80))):
        picture[:] = 20
        stroke(under, colors[0])
        stroke(over, tuple(c // 3 for c in colors[1]), 9)  # its shaded sides
        stroke(over, colors[1])
        lines = wrod.trace_centerlines(picture)
        (crossing,) = find_crossings(lines, picture)
        top = lines[crossing.strands[crossing.over]]
        assert ordered(top, over) < 3.0


def test_bending_energy_of_an_arc():
    # Energy of an arc that turns by 2 phi over the chord d is 4 phi^2 / d (small angles), and the
    # bridge that continues its curvature pays nothing more.
    phi, d = 0.05, 10.0
    directions = np.array([[np.cos(phi), -np.sin(phi)], [-np.cos(phi), -np.sin(phi)]])
    curvature = 2 * phi / d
    energy = bending_energy(
        np.array([[0.0, 0.0], [d, 0.0]]), directions, np.array([curvature, -curvature]), 1.0
    )
    assert energy[0, 1] == pytest.approx(4 * phi**2 / d, rel=1e-6)
    assert energy[1, 0] == pytest.approx(energy[0, 1])


def test_smoothing_keeps_lines_and_halves_its_wavelength():
    n, wavelength = 4000, 40
    s = np.arange(n)
    line = np.column_stack([s, 0.5 * s])
    assert np.allclose(refine.smooth(line, np.ones(n), wavelength), line, atol=1e-4)
    wave = np.column_stack([s, np.sin(2 * np.pi * s / wavelength)])
    middle = refine.smooth(wave, np.ones(n), wavelength)[1000:3000, 1]
    assert np.abs(middle).max() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros(SIZE, bool), "blank"),
        (np.ones(SIZE, bool), "inverted"),
        (np.full((*SIZE, 3), 30, np.uint8), "blank"),
        (np.full((*SIZE, 3), 230, np.uint8), "blank"),
        (np.zeros((8, 8), np.uint8), "too small"),
        (np.zeros((4, 5, 6, 7)), "shape"),
        (np.full(SIZE, np.nan), "finite"),
    ],
)
def test_unusable_pictures_are_refused(image, message):
    with pytest.raises(PerceptionError, match=message):
        wrod.trace_centerlines(image)


def test_noise_alone_is_refused():
    noise = np.random.default_rng(0).normal(200, 4, (*SIZE, 3)).clip(0, 255).astype(np.uint8)
    with pytest.raises(PerceptionError):
        wrod.trace_centerlines(noise)


def test_thick_blob_is_refused():
    blob = np.zeros(SIZE, np.uint8)
    cv2.ellipse(blob, (320, 240), (200, 100), 0, 0, 360, 255, -1)
    with pytest.raises(PerceptionError, match="rod or stroke"):
        wrod.trace_centerlines(blob)


def test_things_that_are_no_strands_are_not_traced():
    mask = draw([spline((60, 60), (200, 80), (420, 60), (580, 100))], 4.0)
    mask[150:260, 200:400] = True
    with pytest.raises(PerceptionError, match="shape of rods"):
        wrod.trace_centerlines(mask)


def test_grey_float_and_16_bit_pictures_agree():
    truth = spline((60, 400), (200, 100), (420, 90), (580, 380))
    grey = np.where(draw([truth], 5.0), 190, 15).astype(np.uint8)
    grey = cv2.GaussianBlur(grey, (0, 0), 1.0)
    for picture in (grey, np.dstack([grey] * 3), grey / 255.0, grey.astype(np.uint16) * 257):
        (line,) = wrod.trace_centerlines(picture)
        assert nearest(line, truth) < 0.2


@pytest.mark.parametrize(
    "ends",
    [((10.3, 8.0), (30.7, 21.4)), ((-20.0, 5.0), (12.0, -3.0)), ((50.0, 60.0), (70.0, 90.0))],
)
def test_a_path_is_drawn_as_wide_as_it_is_also_where_it_leaves_the_picture(ends):
    line = Centerline(np.array(ends), np.full(2, 3.2))
    y, x = np.mgrid[:32, :40]
    start, way = line.points[0], np.diff(line.points, axis=0)[0]
    along = np.clip(((x - start[0]) * way[0] + (y - start[1]) * way[1]) / (way @ way), 0.0, 1.0)
    distance = np.hypot(x - start[0] - along * way[0], y - start[1] - along * way[1])
    sure = np.abs(distance - 3.2) > 0.01  # between its points a path is 0.002 px thinner
    assert ((_draw(line, x.shape) == (distance <= 3.2)) | ~sure).all()
