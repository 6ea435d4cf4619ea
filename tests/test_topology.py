"""Knots and links of known kind, from curves in space."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wrod.errors import RodError
from wrod.knots.topology import diagram, name_of, recognise_knot, recognise_pair

T = np.linspace(0.0, 2 * np.pi, 120, endpoint=False)


def torus(p, q, hand=1):
    r = 2.0 + np.cos(q * T)
    return [np.column_stack([r * np.cos(p * T), r * np.sin(p * T), -hand * np.sin(q * T)])]


def figure_eight():
    r = 2.0 + np.cos(2 * T)
    return [np.column_stack([r * np.cos(3 * T), r * np.sin(3 * T), np.sin(4 * T)])]


def braid(word, strands):
    """Closure of a braid: +k passes the strand at place k over its neighbour, -k under it."""
    paths = [[] for _ in range(strands)]  # (step, place, height) of each strand
    place = list(range(strands))
    for step, letter in enumerate(word):
        k, height = abs(letter) - 1, 0.3 * np.sign(letter)
        for s, now in enumerate(place):
            paths[s].append((step, now, 0.0))
            if now in (k, k + 1):
                shift = 1 if now == k else -1
                paths[s].append((step + 0.5, now + shift / 2, shift * height))
                place[s] = now + shift
    curves, left = [], set(range(strands))
    while left:
        first = s = min(left)
        points = []
        while s in left:
            left.discard(s)
            points += paths[s]
            s = place[s]
        assert s == first
        points = np.array(points, dtype=float)
        points[:, 0] += len(word) * np.cumsum(np.diff(points[:, 0], prepend=0.0) < 0.0)
        corners = np.vstack([points, [points[-1, 0] // len(word) + 1, 0, 0]])
        corners[-1] = [len(word) * corners[-1, 0], *points[0, 1:]]
        fine = np.arange(0, len(points), 0.25)  # four pieces from corner to corner
        step, at, height = (np.interp(fine, np.arange(len(corners)), c) for c in corners.T)
        angle, radius = 2 * np.pi * step / len(word), 3.0 + at
        curves.append(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]))
    return curves


# Name, curves, linking number (tables of knots and links).
KNOWN = [
    ("unknot", [np.column_stack([np.cos(T), np.sin(T), 0.3 * np.sin(2 * T)])], None),
    ("unknot", braid([1, -2, 2, 1, -1, 2], 3), None),
    ("right trefoil", torus(2, 3), None),
    ("left trefoil", torus(2, 3, -1), None),
    ("right trefoil", braid([1, 1, 1], 2), None),
    ("figure-eight", figure_eight(), None),
    ("figure-eight", braid([1, -2, 1, -2], 3), None),
    ("right 5_1", torus(2, 5), None),
    ("left 5_1", braid([-1] * 5, 2), None),
    ("right 5_2", braid([1, 1, 1, 2, -1, 2], 3), None),
    ("left 5_2", braid([-1, -1, -1, -2, 1, -2], 3), None),
    ("reef knot", braid([1, 1, 1, -2, -2, -2], 3), None),
    ("right granny knot", braid([1, 1, 1, 2, 2, 2], 3), None),
    ("left granny knot", braid([-1, -1, -1, -2, -2, -2], 3), None),
    ("unlink", braid([1, -1], 2), 0),
    ("right Hopf link", braid([1, 1], 2), 1),
    ("left Hopf link", braid([-1, -1], 2), -1),
    ("right Solomon link", braid([1] * 4, 2), 2),
    ("mirrored Whitehead link", braid([1, -2, 1, -2, -2], 3), 0),
    ("Whitehead link", braid([-1, 2, -1, 2, 2], 3), 0),
]


@pytest.mark.parametrize(("name", "curves", "linking"), KNOWN, ids=[k[0] for k in KNOWN])
def test_known_knots(name, curves, linking):
    found = diagram(curves)
    assert name_of(curves) == name
    if linking is not None:
        assert found.linking_number() == linking
    # V(1) = (-2)^(curves - 1), for every link.
    assert sum(found.jones_polynomial().values()) == (-2) ** (len(curves) - 1)


@pytest.mark.parametrize("name, curves", [k[:2] for k in KNOWN if k[0] != "unlink"])
def test_turned_and_shaken_they_stay_what_they_are(name, curves):
    rng = np.random.default_rng(1)
    for _ in range(4):
        turn = Rotation.random(rng=rng)
        shaken = [
            turn.apply(c + rng.uniform(-0.03, 0.03, c.shape)) * [1.0, 1.3, 0.8] for c in curves
        ]
        assert name_of(shaken, seed=int(rng.integers(1000))) == name


def test_antiparallel_solomon_link_is_named_as_such():
    one, other = braid([1] * 4, 2)
    assert name_of([one, other[::-1]]) == "left Solomon link, antiparallel"
    assert diagram([one, other[::-1]]).linking_number() == -2


def test_linking_number_is_the_gauss_integral():
    for count in (1, 2):
        curves = braid([1] * (2 * count), 2)
        fine = [
            np.concatenate([a + (b - a) * np.arange(12)[:, None] / 12 for a, b in pairs])
            for pairs in (list(zip(c, np.roll(c, -1, axis=0), strict=True)) for c in curves)
        ]
        r1, r2 = fine
        d1, d2 = (np.roll(r, -1, axis=0) - r for r in fine)
        m1, m2 = r1 + d1 / 2, r2 + d2 / 2
        gap = m1[:, None] - m2[None]
        volume = np.einsum("ijk,ijk->ij", gap, np.cross(d1[:, None], d2[None]))
        integral = (volume / np.linalg.norm(gap, axis=2) ** 3).sum() / (4 * np.pi)
        assert integral == pytest.approx(count, abs=0.02)
        assert diagram(curves).linking_number() == count


def overhand(hand=1):
    """A trefoil, opened on its outside, with long ends."""
    knot = torus(2, 3, hand)[0]
    cut = np.roll(knot, -(int(np.argmax(np.linalg.norm(knot[:, :2], axis=1))) + 1), axis=0)
    return np.vstack([3 * cut[0], cut, 3 * cut[-1]])


def test_open_rod_is_recognised():
    for hand, name in ((1, "right trefoil"), (-1, "left trefoil")):
        found = recognise_knot(overhand(hand))
        assert found.name == name
        assert found.share > 0.9
        assert sum(found.counts.values()) == 15
    # The end drawn back out of its loop: slipped.
    slipped = overhand()[:70]
    slipped = np.vstack([slipped, 4 * slipped[-1]])
    assert recognise_knot(slipped).name == "unknot"
    line = np.column_stack([np.linspace(0, 1, 30), np.zeros(30), np.zeros(30)])
    assert recognise_knot(line).name == "unknot"
    assert recognise_knot(line).share == 1.0


def cut_in_two(word):
    """Two rods of a closed braid of one curve, cut where it runs outermost, ends drawn out."""
    (knot,) = braid(word, 3)
    radius = np.round(np.hypot(knot[:, 0], knot[:, 1]), 6)
    ends = np.flatnonzero((radius == 5.0) & (np.roll(radius, 1) < 5.0))  # arrives on the outside
    first, second = ends[0] + 1, ends[-1] + 1
    rods = [knot[first + 1 : second], np.vstack([knot[second + 1 :], knot[:first]])[::-1]]
    return [np.vstack([3 * r[0], r, 3 * r[-1]]) for r in rods]


def test_two_rods_are_recognised():
    for word, name in (
        ([1, 1, 1, -2, -2, -2], "reef knot"),
        ([1, 1, 1, 2, 2, 2], "right granny knot"),
        ([-1, -1, -1, -2, -2, -2], "left granny knot"),
        ([1, 1, 1, 2, 2, -2], "right trefoil"),  # only half a reef knot
        ([1, 2, 2, -2], "unknot"),
    ):
        found = recognise_pair(*cut_in_two(word))
        assert found.name == name
        assert found.share > 0.6
    apart = np.column_stack([np.linspace(0, 1, 30), np.zeros(30), np.zeros(30)])
    assert recognise_pair(apart, apart + [0.0, 0.1, 0.0]).name == "unknot"


def test_bad_curves_are_refused():
    with pytest.raises(RodError, match="give"):
        diagram(np.zeros((2, 3)))
    with pytest.raises(RodError, match="point 4 is not finite"):
        broken = torus(2, 3)[0].copy()
        broken[4, 1] = np.nan
        recognise_knot(broken)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    with pytest.raises(RodError, match="touch"):
        diagram([square, square])
