"""A deployment that is looked at on the way, as somebody with a robot and a camera uses it."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vps import SHORT as ROD

import wrod
from wrod.deployment.expectation import COARSE, PACE
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.result import errors_along
from wrod.deployment.setup import Disturbance
from wrod.deployment.tangents import lay
from wrod.errors import DataError, PatternError, RodError
from wrod.planning.tail import Tail

WRONG = Disturbance(offset=(0.0, 0.004), yaw=0.01)


@pytest.fixture
def loop(bend, monkeypatch):
    monkeypatch.setattr("wrod.deployment.beliefs._MESH", replace(COARSE, tolerance=1e-4))
    return wrod.FeedbackLoop(bend[0], ROD, bend[1], 0.6, every=0.06)


class Cell:
    """A robot beside its place that goes through poses, and its camera: from poses alone."""

    def __init__(self, pattern):
        self.pattern, self.gone, self.went_on = pattern, [], LastDeployments()
        self.rng = np.random.default_rng(0)

    def go(self, loop, pose=None):
        """Through all poses ahead, or up to that one."""
        ahead = loop.ahead
        if len(loop.looks) < 2:  # all is begun anew after the first look
            self.gone, self.shift = [], self.shifted(ahead)
        self.gone.append(ahead)
        names = ("arc_length", "contact", "position", "rotation", "force")
        joined = {n: np.concatenate([getattr(one, n) for one in self.gone]) for n in names}
        # Where a pattern begins, simulated rods are put down: so all of it is moved back there, and
        # the robot as much further beside.
        x, y, yaw = self.shift
        turn = Rotation.from_euler("z", -yaw)
        for name in ("contact", "position"):
            joined[name] = turn.apply(joined[name] - [x, y, 0.0])
        joined["rotation"] = turn.as_matrix() @ joined["rotation"]
        until = None if pose is None else pose + 1 - len(ahead) or None
        joined = {name: value[:until] for name, value in joined.items()}
        path = replace(ahead, **joined, shape=None, twist=None)
        how = Disturbance(offset=(x + WRONG.offset[0], y + WRONG.offset[1]), yaw=yaw + WRONG.yaw)
        trial = wrod.Trial(self.pattern, ROD, path, wrod.Friction(0.6), how, Tail.none(path))
        release = {"release": float(path.arc_length[-1]) + 0.05} if loop.held else {}
        mesh = replace(COARSE, tolerance=1e-5, laid=self.pattern.length)
        how = {"discretisation": mesh, "speed": PACE, "remembered": [self.went_on], **release}
        (self.lies,) = lay([trial], **how)

    def shifted(self, ahead):
        """Where the beginning of the pattern is to be, which is in the origin (x, y, yaw)."""
        start, end = ahead.contact[0], ahead.contact[8]
        meant = self.pattern.sample(ahead.arc_length[[0, 8]])[0]
        yaw = np.subtract(*(np.arctan2(*(b - a)[1::-1]) for a, b in ((start, end), meant)))
        x, y, _ = start - Rotation.from_euler("z", yaw).apply(meant[0])
        return float(x), float(y), float(yaw)

    def picture(self, laid):
        at = np.arange(0.0, laid - 0.03, 0.01)
        self.rng.shuffle(at)
        xy = [np.interp(at, self.lies.arc_length, self.lies.centerline[:, k]) for k in range(2)]
        return at, np.stack(xy, axis=1) + 2e-4 * self.rng.standard_normal((len(at), 2))


def test_a_loop_of_your_own_makes_up_for_a_robot_beside_its_place(bend, loop):
    """With poses out and points in, and nothing else; by looks of a quarter of a second."""
    loop = wrod.FeedbackLoop(bend[0], ROD, bend[1], 0.6, every=0.06, patience=0.25)
    cell = Cell(bend[0])
    while loop.ahead is not None:
        cell.go(loop)
        look = loop.observe([cell.picture(loop.laid) for _ in range(3)], noise=2e-4)
    assert look is loop.looks[-1] and look.offset == pytest.approx((0.0, 0.004), abs=1e-3)
    left = errors_along(bend[0], cell.lies.arc_length, cell.lies.centerline)[1]
    assert left.mean() < 6e-4  # 4 mm and more without looking
    with pytest.raises(RodError, match="has ended"):
        loop.observe([])


def test_pictures_that_are_none_of_this_rod_are_refused_and_change_nothing(bend, loop):
    cell = Cell(bend[0])
    cell.go(loop)
    at, xy = cell.picture(loop.laid)
    at, xy = np.sort(at), xy[np.argsort(at)]
    nan, far = xy.copy(), xy + [0.5, 0.0]
    nan[2, 1] = np.nan
    wrong = {
        "not finite": (at, nan),
        "give metres, each point with its own arc length": (at, 1e3 * xy),
        "0.5 m from where it is believed": (at, far),
        "leave out a picture of nothing": (at[:0], xy[:0]),
        r"arc lengths from 0 to \d+ m": (1e3 * at, xy),
        "must be an array of numbers": (at, [["here", "there"]] * len(at)),
        r"give \(n,\)": (at[:-1], xy),
    }
    before, ahead = loop.beliefs.accounts, loop.ahead
    for said, picture in wrong.items():
        with pytest.raises(DataError, match=said):
            loop.observe([(at, xy), picture])
    with pytest.raises(DataError, match="own arc length"):
        loop.observe([(at, xy[np.r_[len(at) - 1, 1 : len(at) - 1, 0]])])  # two were exchanged
    with pytest.raises(DataError, match="picture 1 was told before"):
        loop.observe([(at, xy), (at[::-1], xy[::-1])])
    with pytest.raises(DataError, match="no point that lies"):
        loop.observe([(np.array([0.3]), np.array([[0.3, 0.1]]))])
    for none in (None, 5, (at, xy), [(at, xy, 1)]):
        with pytest.raises(DataError, match="give a list of"):
            loop.observe(none)
    with pytest.raises(DataError, match="noise is 0"):
        loop.observe([(at, xy)], noise=0.0)
    assert loop.beliefs.accounts is before and not loop.looks
    assert np.array_equal(loop.ahead.position, ahead.position)
    loop.observe([(at, xy)], noise=2e-4)
    with pytest.raises(DataError, match="picture 0 was told before"):
        loop.observe([(at, xy)])  # a picture of an earlier look
    believed = loop.beliefs.account.mean
    assert np.isnan(loop.observe([]).misfit)  # nothing could be seen
    assert np.array_equal(loop.beliefs.account.mean, believed)


def test_pictures_that_come_late_count_where_they_were_taken(bend, loop):
    """As told by the pose of the grip then: half a second before, what hangs was elsewhere."""
    loop, cell = (
        wrod.FeedbackLoop(bend[0], ROD, bend[1], 0.6, every=0.06, patience=0.15),
        Cell(bend[0]),
    )
    for wrong in (-1, 10, 11, len(loop.ahead), 1.5):  # the tenth ends what is held
        with pytest.raises(DataError, match="of those ahead, where the grip was"):
            loop.observe([], pose=wrong)
    cell.go(loop)
    loop.observe([cell.picture(loop.laid) for _ in range(3)], noise=2e-4)
    pose = len(loop.ahead) - 5
    cell.go(loop, pose)
    at = np.arange(0.0, cell.lies.arc_length[-1] - 0.03, 0.01)
    place = [np.interp(at, cell.lies.arc_length, c) for c in cell.lies.centerline.T]
    place = np.stack(place, axis=1) + 2e-4 * cell.rng.standard_normal((len(at), 3))
    right, late = (
        copy.deepcopy(loop).observe([(at, place)], noise=2e-4, pose=told) for told in (pose, None)
    )
    # Taken for those of the grip that stands, they bend all that is believed.
    assert abs(right.natural_curvature) < 1.0 and abs(right.lgb_error) < 0.05
    assert right.yaw == pytest.approx(0.01, abs=0.008)
    assert abs(late.natural_curvature) > 4.0 and abs(late.lgb_error) > 0.1


def test_points_that_are_none_of_the_rod_are_left_out(bend, loop):
    """A camera that takes something else for the same place of the rod, in every picture."""
    cell, offsets = Cell(bend[0]), []
    cell.go(loop)
    for wrong in (0.0, 8e-3):
        cell.rng = np.random.default_rng(0)
        pictures = [cell.picture(loop.laid) for _ in range(3)]
        for at, xy in pictures:
            xy[np.argmax(at == 0.02), 1] += wrong
        look = copy.deepcopy(loop).observe(pictures, noise=2e-4)
        offsets.append(look.offset[1])
        assert look.left_out == (3 if wrong else 0)
    assert offsets[0] == pytest.approx(4e-3, abs=5e-4)
    assert offsets[1] == pytest.approx(offsets[0], abs=2e-4)  # 2 mm where they count
    # A few, and not whatever there is.
    at = np.arange(0.0, 0.08, 0.01)
    xy = np.column_stack([at, 6e-3 * (np.arange(len(at)) % 3 == 1)])
    with pytest.raises(DataError, match="apart from their neighbours"):
        loop.observe([(at, xy)], noise=2e-4, hanging=1e-3)


def test_a_look_takes_no_longer_than_it_may(bend, loop):
    """What it has come to by then is believed, and gone on with."""
    cell, took = Cell(bend[0]), []
    cell.go(loop)
    pictures = [cell.picture(loop.laid) for _ in range(3)]
    for patience in (8.0, 1e-3):
        mine = wrod.FeedbackLoop(bend[0], ROD, bend[1], 0.6, every=0.06, patience=patience)
        look = mine.observe(pictures, noise=2e-4)
        assert look.hurried == (patience < 1.0)
        assert look.offset == pytest.approx((0.0, 0.004), abs=1e-3) and mine.ahead is not None
        took.append(mine.beliefs.remembered.effort)
    assert took[1] < 0.7 * took[0]


def test_loops_of_other_plans_are_refused(bend):
    with pytest.raises(PatternError):
        wrod.FeedbackLoop(wrod.pattern("letter-L"), ROD, bend[1], 0.6)
    with pytest.raises(RodError, match="friction is -1"):
        wrod.FeedbackLoop(bend[0], ROD, bend[1], -1.0)
