import json
import shlex
import subprocess
import sys
import threading
import warnings
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.commands import main, plan_expected
from wrod.errors import GraspError
from wrod.planning.trajectory import Trajectory


def run(*arguments):
    return CliRunner().invoke(main, ["plan", "--no-robot", "--no-expect", *map(str, arguments)])


@pytest.mark.parametrize("name", ["letter-A", "circle"])
def test_plan_writes_trajectory_and_picture(tmp_path, name):
    out = tmp_path / "new" / "folder"
    result = run(name, "--rod", "green-vps", "--method", "intuitive", "--out", out)
    assert result.exit_code == 0, result.output
    names = {path.name for path in out.iterdir()}
    assert names == {"trajectory.csv", "trajectory.npz", "preview.png"}
    for path in out.iterdir():
        assert f"wrote {path}" in result.output
    assert Trajectory.load(out / "trajectory.npz").metadata["pattern"] == name
    picture = (out / "preview.png").read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) > 30_000


def test_json_has_the_figures_of_the_plan(tmp_path):
    result = run(
        "sine", "--radius", 0.0016, "--lgb", 0.03, "--length", 0.9, "--method", "intuitive",
        "--out", tmp_path, "--json", "--no-remainder",
    )  # fmt: skip
    figures = json.loads(result.stdout)
    assert figures["rod"]["gravito_bending_length"] == 0.03
    assert figures["remainder_length"] == 0.0
    assert figures["required_friction"] > 0.4
    assert figures["highest_grip"] == pytest.approx(0.9)


def test_rod_file(tmp_path):
    rod = wrod.RodMaterial(0.002, 0.03, 0.8, density=1000.0)
    path = wrod.save_rod(rod, tmp_path / "rod.json")
    result = run("line", "--rod", path, "--method", "intuitive", "--out", tmp_path / "o", "--json")
    assert json.loads(result.stdout)["rod"]["density"] == 1000.0


def test_pattern_file_with_units(tmp_path):
    points = wrod.pattern("letter-S").sample(np.linspace(0.0, 0.5, 150))[0]
    np.savetxt(tmp_path / "s.txt", points[:, :2] * 1e3)
    options = ("--rod", "rope", "--method", "intuitive", "--out", tmp_path / "o")
    assert run(tmp_path / "s.txt", *options).exit_code == 2
    result = run(tmp_path / "s.txt", *options, "--units", "mm", "--json")
    assert json.loads(result.stdout)["pattern_length"] == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize(
    "arguments, says",
    [
        (("letter-Z", "--rod", "rope"), "unknown pattern 'letter-Z'"),
        (("missing.txt", "--rod", "rope"), "missing.txt: no such file"),
        (("line", "--rod", "yarn"), "unknown rod 'yarn'"),
        (("line",), "no rod given"),
        (("line", "--radius", 0.001), "--lgb, --length missing"),
        (("line", "--rod", "rope", "--lgb", 1), "were both given"),
        (("line", "--radius", -1, "--lgb", 0.03, "--length", 1), "'--radius': -1.0"),
        (("line", "--radius", 0.001, "--lgb", 0, "--length", 1), "'--lgb': 0.0"),
        (("line", "--radius", 0.001, "--lgb", 0.03, "--length", "nan"), "'--length': nan"),
        (("line", "--radius", 0.001, "--lgb", 0.03, "--length", 0.4), "shorten the pattern"),
        (("line", "--rod", "rope", "--method", "guess"), "unknown method 'guess'"),
        (("line", "--rod", "rope", "--units", "mm"), "drop --units"),
        (("line", "--rod", "rope", "--layer", "a", "--stroke", 1), "drop --layer and --stroke"),
        (("line", "--rod", "rope", "--no-robot", "--robot", "x"), "exclude each other"),
        (("line", "--rod", "rope", "--friction", "-1"), "friction is -1.0"),
        (("line", "--rod", "missing.json"), "missing.json: no such file"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(tmp_path, arguments, says):
    out = tmp_path / "out"
    method = () if "--method" in arguments else ("--method", "intuitive")
    result = run(*arguments, *method, "--out", out)
    assert result.exit_code == 2
    assert says in result.stderr
    assert result.stderr.startswith("wrod: ") and result.stderr.count("\n") == 1
    assert not out.exists()


def test_unwritable_output_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "below"
    result = run("line", "--rod", "rope", "--method", "intuitive", "--out", out)
    assert result.exit_code == 2 and "cannot be written" in result.stderr


def test_main_command_ends_in_joint_path_scene_and_picture(tmp_path, monkeypatch):
    monkeypatch.setattr("wrod.scene.render._MOMENT", (120, 90))  # a small scene.png
    arguments = ["plan", "letter-C", "--rod", "green-vps", "--no-expect", "--out", str(tmp_path)]
    arguments += ["--spacing", "0.005"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    names = {"trajectory.csv", "trajectory.npz", "preview.png", "joint_path.csv"}
    names |= {"joint_path.npz", "scene.usdc", "scene.png"}
    page = {"scene.html"} if find_spec("viser") is not None else set()
    assert {path.name for path in tmp_path.iterdir()} == names | page
    assert all(f"wrote {path}" in result.output for path in tmp_path.iterdir())
    assert "rad from the joint limits" in result.output
    assert "the rod waits at a stand that " in result.output
    assert (tmp_path / "scene.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    "arguments, says",
    [
        (("--placement", "table"), "placement 'table' is not 'auto'"),
        (("--robot", "gone.urdf"), "gone.urdf: no such file"),
        (("--robot", "baxter"), "known robots: sawyer, panda, ur5e"),
        (("--flange", "elbow"), "no link 'elbow' for the gripper's flange"),
        (("--table-height", "nan"), "'--table-height': nan is not"),
        (("--speed", "0"), "'--speed': 0"),
        (("--obstacles", "gone.json"), "gone.json: "),
        (("--no-robot", "--tip", "hand"), "--no-robot and --tip exclude each other"),
        (("--export", "karel"), "unknown format 'karel'"),
        (("--placement", "1,0,0,0", "--table-height", "0"), "drop --table-height"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_solved(
    tmp_path, monkeypatch, arguments, says
):
    def solved(*_, **__):
        raise AssertionError("solved")

    monkeypatch.setattr("wrod.deployment.plan.plan", solved)
    out = tmp_path / "out"
    result = CliRunner().invoke(
        main, ["plan", "line", "--rod", "rope", "--out", str(out), *arguments]
    )
    assert result.exit_code == 2 and says in result.stderr
    assert result.stderr.count("\n") == 1 and not out.exists()


def test_plan_without_a_joint_path_is_kept(tmp_path):
    fixed = ["plan", "line", "--rod", "rope", "--method", "intuitive", "--no-expect"]
    fixed += ["--out", str(tmp_path)]
    result = CliRunner().invoke(main, [*fixed, "--placement", "2,0,-0.3,0", "--no-remedy"])
    assert result.exit_code == 3 and "out of reach at node" in result.stderr
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"trajectory.csv", "trajectory.npz", "preview.png", "reach.png"}
    assert len(Trajectory.load(tmp_path / "trajectory.npz")) > 100


def test_corners_are_rounded_and_said(tmp_path):
    drawing = tmp_path / "l.csv"
    drawing.write_text("x [mm],y [mm]\n0,0\n250,0\n250,250\n")
    options = (drawing, "--rod", "green-vps", "--method", "intuitive", "--json")
    result = run(*options, "--out", tmp_path / "o")
    figures = json.loads(result.stdout)
    assert figures["rounding"]["bound"] == pytest.approx(3.0 / 0.032)
    assert 0.0005 < figures["rounding"]["largest"] < 0.01
    assert figures["largest_curvature"] < 3.0 / 0.032 * 1.001
    assert "rounded" in figures["notes"][0]
    result = run(*options, "--tolerance", 0.0002, "--out", tmp_path / "p")
    assert result.exit_code == 2 and "--tolerance" in result.stderr
    assert not (tmp_path / "p").exists()


def test_too_long_a_pattern_names_a_size_that_fits(tmp_path):
    drawing = tmp_path / "long.csv"
    drawing.write_text("x,y\n0,0\n0.6,0\n0.6,0.6\n")
    options = (drawing, "--rod", "green-vps", "--method", "intuitive")
    result = run(*options, "--out", tmp_path / "o")
    assert result.exit_code == 2 and "`--length 1.2" in result.stderr
    longer = result.stderr.split("--length ")[1].split("`")[0]
    assert run(*options, "--length", longer, "--out", tmp_path / "o").exit_code == 0
    factor = result.stderr.split("--resize ")[1].split("`")[0]
    assert run(*options, "--resize", factor, "--out", tmp_path / "o").exit_code == 0


def test_default_plan_has_shapes_to_draw_unless_told_not_to(tmp_path):
    options = ("line", "--rod", "green-vps", "--spacing", 0.1, "--device", "cpu")
    result = run(*options, "--out", tmp_path / "a")
    assert "the rod solver's grips differ by" in result.output
    trajectory = Trajectory.load(tmp_path / "a" / "trajectory.npz")
    assert trajectory.method == "auto" and trajectory.shape.shape[0] == 6
    assert trajectory.metadata["shapes"]["largest_grip_difference"] < 1e-5
    run(*options, "--out", tmp_path / "b", "--no-shapes")
    assert Trajectory.load(tmp_path / "b" / "trajectory.npz").shape is None


def test_a_pattern_cut_to_the_rod_leaves_the_fingers_off_the_table(tmp_path):
    """The remedy for length is one that an arm can follow, not only the rod."""
    pytest.importorskip("ruckig")
    from wrod.robot.remedy import FINGERS, least_suspended

    rod = wrod.rod("green-vps")
    least = least_suspended(rod)
    height = [
        rod.gravito_bending_length
        * wrod.solve_grasps(
            [part * least / rod.gravito_bending_length], 0.0, rod.stretch_ratio
        ).position[0, 2]
        for part in (1.0, 0.9)
    ]
    assert height[0] > FINGERS + 0.005 > height[1]
    points = np.column_stack([np.linspace(0.0, 1.0, 200), np.zeros(200)])
    np.savetxt(tmp_path / "long.csv", points, delimiter=",")
    words = [str(tmp_path / "long.csv"), "--rod", "green-vps", "--out", str(tmp_path / "o")]
    result = CliRunner().invoke(main, ["plan", *words, "--no-remedy"])
    factor = float(result.output.split("`--resize ")[1].split("`")[0])
    assert result.exit_code == 2 and factor * 1.0 <= rod.length - least
    alone = CliRunner().invoke(main, ["plan", *words, "--no-robot"])
    assert float(alone.output.split("`--resize ")[1].split("`")[0]) > factor


def test_a_closure_beside_a_method_that_has_none_is_refused(tmp_path):
    out = tmp_path / "out"
    arguments = ["plan", "line", "--rod", "green-vps", "--method", "intuitive"]
    arguments += ["--closure", "min_force", "--out", str(out)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert "--closure does nothing beside --method intuitive" in result.output
    assert not out.exists()


def test_what_is_expected_of_the_intuitive_method_is_of_the_table_that_is_named(tmp_path):
    points = np.column_stack([np.linspace(0.0, 0.15, 20), np.zeros(20)])
    np.savetxt(tmp_path / "line.txt", points)
    rod = ("--radius", "0.0016", "--lgb", "0.018", "--length", "0.25", "--method", "intuitive")
    options = (*rod, "--friction", "0.3", "--device", "cpu", "--json")
    figures = json.loads(run(tmp_path / "line.txt", *options, "--out", tmp_path / "o").stdout)
    assert figures["expected"]["friction"][0] == pytest.approx(0.27) and "optimised" not in figures
    assert figures["beyond_grip"] == 0.0


def test_a_table_that_is_none_is_refused_before_a_solver_is_loaded(tmp_path):
    words = ["plan", "line", "--rod", "green-vps", "--out", str(tmp_path / "out")]
    refused = {
        "friction is (0.5, 0.2)": ["--friction", "0.5:0.2"],
        "--pace is '0.02:nan'; give 0.0005 to 10": ["--friction", "0.3", "--pace", "0.02:nan"],
    }
    code = f"""
import sys
from wrod.commands import main
for options in {[*refused.values()]!r}:
    try:
        main({words!r} + options)
    except SystemExit as end:
        print(end.code, "warp" in sys.modules, "torch" in sys.modules)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.split() == 2 * ["2", "False", "False"]
    for says, line in zip(refused, ran.stderr.splitlines(), strict=True):
        assert says in line


def test_a_pattern_is_laid_from_its_other_end(tmp_path):
    options = ("letter-A", "--rod", "green-vps", "--method", "intuitive")
    run(*options, "--out", tmp_path / "a")
    result = run(*options, "--reverse", "--json", "--out", tmp_path / "b")
    figures = json.loads(result.stdout)
    assert figures["notes"][0] == "laid from its other end"
    there, back = (Trajectory.load(tmp_path / name / "trajectory.npz") for name in "ab")
    assert np.abs(there.contact[[0, -1]] - back.contact[[-1, 0]]).max() < 2e-3


def test_what_is_tried_for_an_arm_lays_tight_bends_last():
    from wrod.commands.plan_pattern import Shaping, shorter

    angle = np.linspace(0.0, 3.5 * np.pi, 2000)
    out = (0.02 + 0.008 * angle)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    spiral, rod = wrod.Pattern.from_points(out), wrod.rod("green-vps")
    wanted = Shaping(None, 0.01, None)
    tries = shorter(spiral, rod, wanted)
    assert all(tried.reverse for tried in tries) and len({tried.resize for tried in tries}) == 7
    for tried in tries:
        left = tried.hold - tried.resize * spiral.length
        assert left == pytest.approx(5.6 * rod.gravito_bending_length, abs=1e-3)
        assert tried.hold <= rod.length
    assert not shorter(spiral.reversed(), rod, wanted)[0].reverse
    # A pattern that is reversed already stays so, or is turned back.
    assert shorter(spiral, rod, Shaping(None, 0.01, None, reverse=True))[0].reverse is False


def test_only_what_was_solved_is_said_to_help(capsys):
    from types import SimpleNamespace

    from wrod.commands.plan_pattern import Shaping
    from wrod.commands.plan_steps import fitting
    from wrod.errors import PatternError, RobotError

    def solve(trajectory):
        if trajectory > 0.7:
            raise RobotError("no joint path")

    def planned(wanted, tried=False):
        if wanted.resize < 0.65:
            raise PatternError("bends too much")
        return SimpleNamespace(rod=None), None, wanted.resize

    request = SimpleNamespace(robot="sawyer", solve=solve)
    tries = [Shaping(size, 0.01, 0.5, reverse=True) for size in (0.6, 0.8, 0.7)]
    words = ["my drawing.csv", "--rod", "rope", "--hold", "0.8", "--out", "o", "--export", "poses"]
    with planning(*words):
        said = fitting(request, tries, planned, "too long")
        told = capsys.readouterr().err
        assert "too long; looking" in told and "trying 0.8 of its size" in told
        none = fitting(request, tries[:2], planned, "too long")
        assert none.startswith("no joint path of sawyer")
    # The whole command, to be copied: what was given, and what helps.
    command = shlex.split(said.split("is found: ")[1])
    assert command[:3] == ["wrod", "plan", "my drawing.csv"]
    with planning(*command[2:]) as context:
        now = context.params
    assert (now["resize"], now["hold"], now["reverse"], now["remainder"]) == (0.7, 0.5, True, False)
    assert (now["rod_name"], str(now["out"]), now["exports"]) == ("rope", "o", ("poses",))
    assert now["robot"] == "sawyer" and "--robot" not in command


def test_a_placement_that_has_to_be_given_up_is_said(monkeypatch):
    from types import SimpleNamespace

    from wrod.commands.plan_steps import _remedy
    from wrod.robot import remedy

    monkeypatch.setattr(remedy, "remedies", lambda *_: iter([{"table_height": -0.15}]))
    arm = {"flange": None, "tip": None, "gripper_length": None}
    tried = SimpleNamespace(branch=SimpleNamespace(placement=SimpleNamespace(z=-0.25)))
    for placement, elsewhere in (("5,0,-0.25,0", True), ("auto", False)):
        request = SimpleNamespace(placement=placement, **arm)
        with planning("line", "--rod", "rope", "--out", "o", "--placement", placement):
            said = _remedy(request, SimpleNamespace(best=tried), None, None, None, None)
        assert said.startswith("placed elsewhere and " * elsewhere + "with the table 10 cm higher")


def planning(*words):
    """The context of `wrod plan` with these words."""
    from wrod.commands.plan import command

    return command.make_context("plan", list(words))


def test_sizes_are_tried_as_the_printed_command_plans_them(tmp_path, monkeypatch):
    from wrod.commands.robot_options import RobotRequest

    angle = np.linspace(0.0, 3.5 * np.pi, 2000)
    out = (0.02 + 0.012 * angle)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    np.savetxt(tmp_path / "spiral.csv", out, delimiter=",")
    tried = []
    monkeypatch.setattr(RobotRequest, "solve", lambda self, path: tried.append(path))
    words = ["plan", str(tmp_path / "spiral.csv"), "--rod", "green-vps", "--spacing", "0.02"]
    words += ["--no-shapes", "--no-expect", "--device", "cpu", "--out", str(tmp_path / "o")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2 and len(tried) == 1
    command = shlex.split(result.stderr.strip().split("is found: ")[1])
    again = CliRunner().invoke(main, [*command[1:], "--no-robot"])
    assert again.exit_code == 0, again.stderr
    laid = Trajectory.load(tmp_path / "o" / "trajectory.npz")
    assert laid.metadata["remainder_length"] == tried[0].metadata["remainder_length"] == 0.0
    np.testing.assert_allclose(laid.position, tried[0].position, atol=1e-9)


def test_where_a_hand_cannot_turn_so_far_less_turning_or_another_arm_is_tried(monkeypatch):
    from types import SimpleNamespace

    from wrod.robot import remedy
    from wrod.robot.model import load_robot

    angle = np.linspace(0.0, 2.2 * np.pi, 300)
    ring = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    above = ring + [0.0, 0.0, 0.5]
    monkeypatch.setattr(remedy, "other_height", lambda *a: None)

    def tried(robot, led):
        trajectory = SimpleNamespace(
            contact=ring, position=above, metadata={"remainder_length": led}, arc_length=angle,
            spin=0.0,
        )  # fmt: skip
        task = SimpleNamespace(trajectory=trajectory, robot=load_robot(robot), clearance=0.005)
        failed = SimpleNamespace(task=task)
        curve = SimpleNamespace(length=0.6, remainder_length=led)
        return list(remedy.remedies(failed, wrod.rod("green-vps"), curve, None))

    panda = tried("panda", 0.1)
    assert panda[0] == {"remainder": False}
    others = [change["robot"] for change in panda if "robot" in change]
    assert "gen3" in others and "panda" not in others and "iiwa" not in others
    assert {"remainder": False} not in tried("panda", 0.0)
    assert not any("robot" in change for change in tried("gen3", 0.1))
    # Much too far: the hand is spun back, then smaller from its other end, then an arm that can.
    angle *= 1.6
    ring[:, 0], ring[:, 1] = 0.1 * np.cos(angle), 0.1 * np.sin(angle)
    *spun, second, _, third = tried("panda", 0.1)[:7]
    room = 2 * 2.8973
    for change, part in zip(spun[:2], (0.75, 0.6), strict=True):
        left = (angle[-1] - angle[angle >= 0.1][0]) + np.radians(change["spin"])
        assert part * room - np.radians(10.0) <= left <= part * room + 0.03
    assert [{*change} - {"spin"} for change in spun] == [
        {"remainder"}, {"remainder"}, set(), {"resize", "hold", "remainder"}
    ]  # fmt: skip
    assert second["reverse"] and second["resize"] < 1.0 and third == {"robot": "ur5e"}


@pytest.mark.parametrize("beside", [True, False])
def test_what_to_expect_is_found_out_beside_or_before(beside, monkeypatch):
    """A thread lays it while what is within is done; a plan that cannot be laid says so."""
    within = threading.Event()

    def foresee(curve, rod, trajectory, friction, device, watch):
        assert not beside or within.wait(10.0)
        if rod is None:
            raise GraspError("no such rod")
        return {"mean": 0.1}

    monkeypatch.setattr("wrod.deployment.expectation.foresee", foresee)
    monkeypatch.setattr(plan_expected, "usable_cores", lambda: 2)
    for rod in ("rope", None):
        trajectory = SimpleNamespace(metadata={})
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            within.clear()
            asked = (None, rod, trajectory, None, "cpu")
            with plan_expected.expecting(*asked, beside=beside) as wait:
                assert ("expected" in trajectory.metadata) == (not beside)
                within.set()
                assert wait() == beside and not wait()
        assert trajectory.metadata["expected"] == (rod and {"mean": 0.1})
        assert [str(one.message) for one in said] == (
            [] if rod else ["not laid in simulation: no such rod"]
        )


def test_nobody_waits_for_what_to_expect_of_a_plan_that_was_given_up(monkeypatch):
    watched = threading.Event()

    def foresee(curve, rod, trajectory, friction, device, watch):
        while True:
            watch(np.zeros(4))
            watched.set()

    monkeypatch.setattr("wrod.deployment.expectation.foresee", foresee)
    monkeypatch.setattr(plan_expected, "usable_cores", lambda: 2)
    asked = (None, None, SimpleNamespace(metadata={}), None, "cpu")
    with pytest.raises(KeyboardInterrupt), plan_expected.expecting(*asked, beside=True):
        assert watched.wait(10.0)
        raise KeyboardInterrupt


def test_bench_plan_takes_a_folder_whose_first_pattern_bends(tmp_path):
    angle = np.linspace(0.0, 6.0, 200)
    bent = 0.09 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    np.savetxt(tmp_path / "circle.txt", bent)
    words = ["bench", "plan", "--patterns", str(tmp_path), "--method", "intuitive"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0 and "3 plans" in result.output, result.output
