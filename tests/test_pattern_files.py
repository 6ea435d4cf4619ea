import numpy as np
import pytest

import wrod
from wrod.errors import PatternError

_T = np.linspace(0.0, 1.0, 60)
POINTS = np.stack([0.4 * _T, 0.05 * np.sin(6.0 * _T)], axis=1)
LENGTH = wrod.Pattern.from_points(POINTS).length


def write(path, points, header=""):
    rows = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in points)
    path.write_text(header + rows + "\n")
    return path


@pytest.mark.parametrize(
    "header, scale",
    [
        ("", 1.0),
        ("# units: mm\n", 1e3),
        ("x [cm] y [cm]\n", 1e2),
        ("x_mm,y_mm\n", 1e3),
        ("% my letter\nmillimetres\n", 1e3),
    ],
)
def test_units_of_a_header(tmp_path, header, scale):
    pattern = wrod.Pattern.load(write(tmp_path / "p.txt", POINTS * scale, header))
    assert pattern.length == pytest.approx(LENGTH, rel=1e-6)


def test_csv_with_named_columns_in_another_order(tmp_path):
    path = tmp_path / "p.csv"
    rows = [f"{i};{y * 1e3:.6f};{x * 1e3:.6f}" for i, (x, y) in enumerate(POINTS)]
    path.write_text("\ufeffid;y (mm);x (mm)\n" + "\n".join(rows))
    assert wrod.Pattern.load(path).sample(0.0)[0][0] == pytest.approx([0, 0, 0], abs=1e-6)
    assert wrod.Pattern.load(path).length == pytest.approx(LENGTH, rel=1e-5)


def test_cells_between_quotes_and_columns_that_count_the_points(tmp_path):
    path = tmp_path / "p.csv"
    rows = [f'"{x:.9g}","{y:.9g}"' for x, y in POINTS]
    path.write_text("\n".join(['"x","y"', *rows]))
    assert wrod.Pattern.load(path).length == pytest.approx(LENGTH, rel=1e-6)
    path.write_text("\n".join(f"{i},{x:.9g},{y:.9g}" for i, (x, y) in enumerate(POINTS)))
    with pytest.raises(PatternError, match="line 1: its first column counts the points"):
        wrod.Pattern.load(path)


def test_numpy_files(tmp_path):
    np.save(tmp_path / "a.npy", POINTS * 1e3)
    np.savez(tmp_path / "b.npz", points=POINTS * 100, units="cm")
    assert wrod.Pattern.load(tmp_path / "a.npy", units="mm").length == pytest.approx(LENGTH)
    assert wrod.Pattern.load(tmp_path / "b.npz").length == pytest.approx(LENGTH)


def test_height_of_the_plane_is_kept():
    flat = np.column_stack([POINTS, np.full(len(POINTS), 0.7)])
    assert wrod.Pattern.from_points(flat).sample([0.0, 0.1])[0][:, 2] == pytest.approx([0.7, 0.7])


def test_two_points_are_the_line_between_them():
    line = wrod.Pattern.from_points([[0.1, 0.0], [0.1, 0.4]])
    position, tangent, curvature = line.sample([0.0, 0.3])
    assert line.length == pytest.approx(0.4, abs=1e-12)
    assert position[1] == pytest.approx([0.1, 0.3, 0.0], abs=1e-9)
    assert tangent == pytest.approx(np.array([[0.0, 1.0, 0.0]] * 2), abs=1e-9)
    assert curvature == pytest.approx([0.0, 0.0], abs=1e-9)


def changed(index, axis, by):
    points = np.column_stack([POINTS, np.zeros(len(POINTS))])
    points[index, axis] += by
    return points


@pytest.mark.parametrize(
    "points, says",
    [
        (changed(20, 1, np.nan), "line 21: a coordinate is nan"),
        (changed(20, 0, np.inf), "line 21: a coordinate is inf"),
        (POINTS[[0, 5, 0]], "goes to and fro on one line"),
        (np.zeros((2, 2)), "is one point; give at least 2"),
        (np.insert(POINTS, 20, POINTS[19], axis=0), "line 21: repeats the point before"),
        (changed(30, 2, 0.05), "line 31: .*one horizontal plane"),
        (changed(30, 1, 0.005), "line 31: .*spike of curvature"),
        (changed(30, 1, 0.0012), "line 31: .*spike of curvature"),
    ],
)
def test_bad_points_are_named_by_file_and_line(tmp_path, points, says):
    path = write(tmp_path / "bad.txt", points)
    with pytest.raises(PatternError, match=rf"bad\.txt.*{says}"):
        wrod.Pattern.load(path)


@pytest.mark.parametrize(
    "content, says",
    [
        ("", "holds no points"),
        ("only words\n", "holds no points"),
        ("0 0\n0.1x 0\n0.2 0.1\n", "line 2: '0.1x 0' is not a row of numbers"),
        ("0 0\n0.1 0 5\n0.2 0.1\n", "line 2: holds 3 numbers, 2 are expected"),
        ("1\n2\n3\n", "line 1: holds 1 numbers"),
        ("0 0 0 1\n1 0.1 0 1\n2 0.2 0 1\n", "line 1: holds 4 columns without names"),
        ("x [furlong] y [furlong]\n0 0\n1 0\n2 1\n", "unknown units 'furlong'"),
        ("x [mm] y [cm]\n0 0\n1 0\n2 1\n", "line 1: the columns have different units"),
    ],
)
def test_bad_files_are_named(tmp_path, content, says):
    path = tmp_path / "bad.txt"
    path.write_text(content)
    with pytest.raises(PatternError, match=rf"bad\.txt.*{says}"):
        wrod.Pattern.load(path)


def test_contradicting_and_unknown_units(tmp_path):
    path = write(tmp_path / "p.txt", POINTS, "# units: mm\n")
    with pytest.raises(PatternError, match="drop one"):
        wrod.Pattern.load(path, units="cm")
    with pytest.raises(PatternError, match="unknown units 'parsec'"):
        wrod.Pattern.from_points(POINTS, units="parsec")


def test_pickles_binaries_and_missing_files_are_refused(tmp_path):
    np.save(tmp_path / "evil.npy", np.array([{}, 1], dtype=object))
    (tmp_path / "binary.txt").write_bytes(bytes(range(256)))
    for name in ("evil.npy", "binary.txt", "missing.txt"):
        with pytest.raises(PatternError, match=name):
            wrod.Pattern.load(tmp_path / name)


def test_noise_is_not_taken_for_spikes():
    rng = np.random.default_rng(3)
    for _ in range(20):
        noisy = POINTS + 5e-4 * rng.normal(size=POINTS.shape)
        assert wrod.Pattern.from_points(noisy).noise == pytest.approx(5e-4, rel=0.5)


def test_given_noise_level_sets_the_smoothing():
    noisy = POINTS + 5e-4 * np.random.default_rng(3).normal(size=POINTS.shape)
    rough = wrod.Pattern.from_points(noisy, smoothing=0.0)
    smooth = wrod.Pattern.from_points(noisy, smoothing=5e-4)
    bends = [np.ptp(p.sample(np.linspace(0.0, p.length, 500))[2]) for p in (rough, smooth)]
    assert bends[0] > 10.0 * bends[1]
    with pytest.raises(PatternError, match="smoothing"):
        wrod.Pattern.from_points(POINTS, smoothing=-1.0)


@pytest.mark.parametrize("count", [3, 4, 5, 6, 7, 8, 9])
def test_few_points_make_a_curve_through_them(count):
    angle = np.linspace(0.0, 0.8, count)
    points = 0.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pattern = wrod.Pattern.from_points(points)
    assert pattern.length == pytest.approx(0.16, rel=2e-3)
    np.testing.assert_allclose(pattern.sample(pattern.length)[0][0, :2], points[-1], atol=1e-4)


CORNERS = np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0.4, 0.2]])


def test_four_points_are_the_lines_between_them():
    pattern = wrod.Pattern.from_points(CORNERS)
    far, _ = pattern.departure()
    assert far < 1e-3  # two turns of 2 mm each; a curve through the four was off by 35 mm
    assert pattern.length == pytest.approx(0.6, abs=2e-3)
    position = pattern.sample([0.1, 0.3, 0.5])[0][:, :2]
    np.testing.assert_allclose(position, [[0.1, 0], [0.2, 0.1], [0.3, 0.2]], atol=1e-3)


def test_corner_among_many_points_is_no_spike():
    leg = np.linspace(0.0, 0.2, 41)
    points = np.concatenate(
        [np.column_stack([leg, 0 * leg]), np.column_stack([0.2 + 0 * leg, leg])[1:]]
    )
    pattern = wrod.Pattern.from_points(points)
    assert pattern.departure()[0] < 5e-4


def test_points_that_are_all_corners_are_corners():
    """A star and a long zigzag: no curve is sampled by points at each of which it turns so."""
    zigzag = np.array([[0.1 * k, 0.1 * (k % 2)] for k in range(11)])
    angle = np.pi * np.arange(11) / 5
    star = np.where(np.arange(11) % 2, 0.06, 0.14)[:, None] * np.c_[np.cos(angle), np.sin(angle)]
    for points in (zigzag, star):
        pattern = wrod.Pattern.from_points(points)
        assert pattern.departure()[0] < 4e-3  # two of the corners' widths
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert pattern.length == pytest.approx(length, rel=0.01)


def test_points_of_a_circle_stay_a_curve():
    angle = np.linspace(0.0, 1.5 * np.pi, 12)
    points = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    curvature = wrod.Pattern.from_points(points).sample(np.linspace(0.05, 0.4, 50))[2]
    assert np.abs(curvature - 10.0).max() < 0.5
    # ... and says how far it leaves the chords: a sagitta.
    assert wrod.Pattern.from_points(points).departure()[0] == pytest.approx(
        0.1 * (1 - np.cos(0.75 * np.pi / 11)), rel=0.2
    )


def test_scaled_pattern_is_similar():
    pattern = wrod.Pattern.from_points(POINTS)
    half = pattern.scaled(0.5)
    s = np.linspace(0.0, pattern.length, 60)
    assert half.length == pytest.approx(pattern.length / 2)
    here, there = (p.sample(t) for p, t in ((pattern, s), (half, s / 2)))
    np.testing.assert_allclose(there[0] - there[0][0], (here[0] - here[0][0]) / 2, atol=1e-6)
    np.testing.assert_allclose(there[2], 2 * here[2], atol=1e-4)


@pytest.mark.parametrize("row", ["{x};{y}", "{x} {y}", "{x}\t{y}"])
def test_decimal_commas_are_understood(tmp_path, row):
    path = tmp_path / "p.csv"
    lines = [row.format(x=f"{x:.6f}", y=f"{y:.6f}").replace(".", ",") for x, y in POINTS]
    path.write_text("\n".join(lines))
    assert wrod.Pattern.load(path).length == pytest.approx(LENGTH, rel=1e-4)


def test_decimal_commas_between_commas_are_refused(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("\n".join(f"0,{int(1e4 * x)},0,{int(1e4 * y + 500)}" for x, y in POINTS))
    with pytest.raises(PatternError, match=r"p\.csv, line 1: .*decimal commas"):
        wrod.Pattern.load(path)


def test_points_that_no_smooth_curve_follows_are_said_to_be_missed():
    k = np.arange(200)
    zigzag = wrod.Pattern.from_points(np.column_stack([1e-3 * k, 0.05 * (k % 2)]))
    assert zigzag.departure()[0] > 0.02
    apart = np.concatenate([POINTS, POINTS + [5.0, 0.0]])
    with pytest.raises(PatternError, match=f"point {len(POINTS) + 1}: is .* from the point before"):
        wrod.Pattern.from_points(apart)


@pytest.mark.parametrize(
    "names", ["r,theta", "lat lon", "arc_length,contact_x,contact_y,contact_z"]
)
def test_columns_that_are_no_coordinates_are_refused(tmp_path, names):
    path = write(tmp_path / "p.csv", POINTS, f"{names}\n")
    with pytest.raises(PatternError, match="names other columns than x and y"):
        wrod.Pattern.load(path)
