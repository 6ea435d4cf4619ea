"""Scene files of posts and clips, and whether a cable lies between them."""

import json
from pathlib import Path

import numpy as np
import pytest

import wrod
from wrod.deployment.fixtures import Fixture, Fixtures
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.errors import SceneError
from wrod.solvers.solids import Box, Cylinder

ROD = wrod.RodMaterial(0.0016, 0.03, 0.30)


def gate_scene():
    turn = np.radians(20.0) / 2
    return Fixtures(
        (
            Fixture("left", Cylinder((0.10, 0.012, 0.004), 0.005, 0.004)),
            Fixture("right", Cylinder((0.10, -0.012, 0.004), 0.005, 0.004)),
            Fixture(
                "wall",
                Box((0.2, 0.02, 0.003), (0.01, 0.004, 0.003), (0, 0, np.sin(turn), np.cos(turn))),
            ),
            Fixture("post", Cylinder((0.2, -0.02, 0.003), 0.004, 0.003)),
        ),
        (("left", "right"), ("wall", "post")),
        "test",
    )


def line(x, y=0.0, z=0.0):
    x = np.asarray(x, dtype=float)
    return np.column_stack([x, np.broadcast_to(y, x.shape), np.broadcast_to(z, x.shape)])


def along(nodes, points=20):
    """Points of all edges, not their ends alone."""
    at = np.arange(points * (len(nodes) - 1) + 1) / points
    return np.column_stack([np.interp(at, np.arange(len(nodes)), x) for x in nodes.T])


def test_scene_file_round_trip(tmp_path):
    scene = gate_scene()
    again = Fixtures.load(scene.save(tmp_path / "scene.json"))
    assert again.gates == scene.gates
    for one, other in zip(scene.items, again.items, strict=True):
        assert one.name == other.name
        assert type(one.shape) is type(other.shape)
        assert np.allclose(one.shape.center, other.shape.center)
        assert one.top == pytest.approx(other.top)
        assert one.yaw == pytest.approx(other.yaw)
    assert again.items[2].yaw == pytest.approx(np.radians(20.0))


def test_judge():
    scene, x = gate_scene(), np.linspace(0.0, 0.3, 61)
    assert scene.judge(line(x), 0.002).placed
    backwards = scene.judge(line(x)[::-1], 0.002)
    assert not backwards.gates.any()  # the left fixtures are on the right
    aside = scene.judge(line(x, np.where(x > 0.15, 0.03, 0.0)), 0.002)
    assert aside.gates.tolist() == [True, False]
    assert "gate 2" in str(aside)
    above = scene.judge(line(x, 0.0, np.where(x < 0.15, 0.007, 0.0)), 0.002)
    assert above.gates.tolist() == [False, True]
    short = scene.judge(line(x[:30]), 0.002)
    assert short.gates.tolist() == [True, False]
    # Back and forth through a gate is not between its posts.
    folded = scene.judge(line(np.concatenate([x, x[::-1], x])), 0.002)
    assert not folded.gates.any()


def test_gates_must_be_passed_in_order():
    scene = gate_scene()
    swapped = Fixtures(scene.items, scene.gates[::-1], "swapped")
    found = swapped.judge(line(np.linspace(0.0, 0.3, 61)), 0.002)
    assert found.gates.all()
    assert not found.placed
    assert "order" in str(found)


def test_posts_along_a_pattern_leave_the_gap():
    pattern = wrod.pattern("letter-U")
    scene = Fixtures.along(pattern, [0.1, 0.25, 0.4], gap=0.012, radius=0.004)
    for left, right in scene.gates:
        by_name = {item.name: item.shape for item in scene.items}
        apart = np.subtract(by_name[left].center, by_name[right].center)
        assert np.linalg.norm(apart) - 0.008 == pytest.approx(0.012, abs=2e-5)
    centerline = pattern.sample(np.linspace(0.0, pattern.length, 200))[0]
    assert scene.judge(centerline, 0.0018).placed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="other"), "format"),
        (lambda d: d.update(fixtures=[]), "fixtures"),
        (lambda d: d.update(script="print()"), "unknown entry 'script'"),
        (lambda d: d["fixtures"][0].pop("name"), r"fixtures\[0\] lacks the entry 'name'"),
        (
            lambda d: d["fixtures"][0]["cylinder"].update(radius=-1),
            r"cylinder\.radius must be a number > 0",
        ),
        (
            lambda d: d["fixtures"][0]["cylinder"].update(radius="1"),
            r"cylinder\.radius must be a number, but is text",
        ),
        (
            lambda d: d["fixtures"][0]["cylinder"].update(center=[0, 1]),
            "must be a list of length 3",
        ),
        (lambda d: d["fixtures"][2]["box"].update(size=[1, float("nan"), 1]), "NaN and infinity"),
        (lambda d: d["fixtures"][2].update(sphere={}), "unknown entry 'sphere'"),
        (lambda d: d["fixtures"][1].update(name="left"), "named twice"),
        (lambda d: d["gates"].append(["left", "nobody"]), "'nobody'"),
        (lambda d: d["gates"].append("left"), "must be a list, but is text"),
    ],
)
def test_bad_scene_files_are_refused(tmp_path, change, message):
    path = gate_scene().save(tmp_path / "scene.json")
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(SceneError, match=message):
        Fixtures.load(path)


def test_unreadable_files_are_refused(tmp_path):
    (tmp_path / "broken.json").write_text('{"format":')
    for name in ("broken.json", "missing.json"):
        with pytest.raises(SceneError, match=name):
            Fixtures.load(tmp_path / name)


def test_fixtures_hold_what_friction_does_not():
    """A stiff rod on a slippery table straightens out of its bend, unless posts keep it."""
    from wrod.patterns.shapes import straight, strokes, turn

    pattern = wrod.Pattern(*strokes(0.0, straight(0.06), turn(60.0, 0.06, 0.05), straight(0.03)))
    trajectory = wrod.plan(pattern, ROD, "numeric", device="cpu")
    scene = Fixtures.along(
        pattern, np.linspace(0.03, pattern.length - 0.02, 4), gap=0.008, height=0.006
    )
    jobs = [
        Trial(pattern, ROD, trajectory, wrod.Friction(0.1), fixtures=f) for f in (None, scene, None)
    ]
    bare, held, again = simulate_deployments(
        jobs, discretisation=wrod.Discretisation(0.006, 0.02), speed=0.03, threads=1
    )
    assert not scene.judge(bare.released_centerline, ROD.radius).placed
    assert scene.judge(held.released_centerline, ROD.radius).placed
    assert np.abs(bare.centerline - again.centerline).max() < 1e-9  # trials come back in order
    posts = np.array([item.shape.center[:2] for item in scene.items])
    rod = along(held.released_centerline)
    gap = np.linalg.norm(rod[:, None, :2] - posts, axis=2) - 0.005
    assert gap.min() > 0.95 * ROD.radius


@pytest.mark.parametrize("name", ["U", "S"])
def test_shipped_scenes_fit_their_patterns(name):
    folder = Path(wrod.__file__).parents[1] / "scenes" / "cable"
    pattern = wrod.Pattern.load(folder / f"{name}.csv")
    scene = Fixtures.load(folder / f"{name}.json")
    centerline = pattern.sample(np.linspace(0.0, pattern.length, 300))[0]
    assert scene.judge(centerline, wrod.rod("cable").radius).placed
    for item in scene.items:
        away = np.linalg.norm(centerline[:, :2] - item.shape.center[:2], axis=1).min()
        assert away > item.shape.radius + wrod.rod("cable").radius
