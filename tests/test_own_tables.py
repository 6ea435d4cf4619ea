"""An engineer's tables become the arrays that they are of, by the lines of docs/how-to."""

import numpy as np
import pytest
from own_tables import HELD, write_tables
from test_docs import ROOT, blocks
from test_ruler import L_GB

import wrod

PAGE = ROOT / "docs" / "how-to" / "own-measurements.md"


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """(folder, the arrays that the tables are of, what the page's lines leave)."""
    folder = tmp_path_factory.mktemp("tables")
    names: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        true = write_tables(folder)
        for body in blocks(PAGE, "python"):
            exec(compile(body, PAGE.name, "exec"), names)
    return folder, true, names


def test_tables_of_clamped_rods_become_measurements(read):
    folder, true, _ = read
    found = np.load(folder / "measurements.npz")
    for name in set(true["clamped"]) - {"train_idx", "test_idx"}:
        np.testing.assert_allclose(found[name], true["clamped"][name], atol=1e-8, err_msg=name)
    m = wrod.load_measurements(folder / "measurements.npz")
    assert sorted([*m.train, *m.test]) == list(range(12)) and len(m.test) == 4


def test_takes_with_y_up_become_recordings(read):
    folder, true, _ = read
    found, given = np.load(folder / "motion.npz"), true["motion"]
    np.testing.assert_allclose(found["positions"], given["positions"], atol=1e-8)
    assert found["rate_hz"] == pytest.approx(100.0) and list(found["file_ids"]) == list(
        given["file_ids"]
    )
    m = wrod.load_motion(folder / "motion.npz")
    assert m.filled == 1 and m.lost_frames == 0


def test_a_cable_in_the_hand_and_a_loop_are_found(read):
    folder, true, names = read
    for name, is_so in (("stiffness", np.log(HELD.stiffness)), ("curvature 0", HELD.curvature)):
        k = names["held"].names.index(name)
        assert abs(names["held"].values[k] - is_so) < 3.0 * names["errors"][k]
    loop = wrod.identification.hanging_loop.measure_hanging_loop(
        1e-3 * np.loadtxt(folder / "loop.csv", delimiter=",")
    )
    assert loop.gravito_bending_length == pytest.approx(L_GB, abs=3.0 * loop.error)
    laid = np.loadtxt(folder / "laid-1.csv", delimiter=",")
    np.testing.assert_allclose(laid, true["laid"]["points"], atol=1e-8)
