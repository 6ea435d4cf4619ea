"""Controllers of one naturally curved rod: what they learn, know, and refuse."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from cli import done, run, told
from scipy.spatial.transform import Rotation
from test_deployment import ROD, quarter_turn
from wrod.training.dataset import GraspTable, generate, load
from wrod.training.loop import Training
from wrod.training.recipes import recipe
from wrod.training.sampling import RodInputs
from wrod.training.score import held_out, score

import wrod
from wrod.controller.controller import Controller
from wrod.controller.curved import SLOW, decode, encode, twisted, untwisted
from wrod.errors import DataError, GraspError
from wrod.grasps.optimal import solve_grasps

CURVED = replace(ROD, natural_curvature=(0.0, 6.0), length=0.26)
ONE = RodInputs.of(CURVED, "plane")


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Dataset and training by their commands: the folder of both."""
    folder = tmp_path_factory.mktemp("curved")
    model = str(wrod.save_rod(CURVED, folder / "rod.json"))
    for args in (
        ["dataset", "--size", "300", "--rod", model, "--roll", "plane",
         "--out", str(folder / "grasps")],
        ["train", "--dataset", str(folder / "grasps"), "--out", str(folder / "trained"),
         "--steps", "800", "--width", "32", "--test", "40"],
    ):  # fmt: skip
        done(*args, "--device", "cpu", "--json")
    return folder


@pytest.fixture(scope="module")
def controller(made):
    return Controller.load(made / "trained" / "controller.safetensors")


def test_twisting_is_undone():
    rng = np.random.default_rng(0)
    rotation = Rotation.from_rotvec(rng.normal(size=(50, 3)))
    twist = rng.uniform(-9, 9, 50)
    turned = twisted(np, rotation.as_rotvec(), twist)
    expected = rotation * Rotation.from_rotvec(np.outer(twist, [1, 0, 0]))
    assert (Rotation.from_rotvec(turned).inv() * expected).magnitude().max() < 1e-9
    assert np.abs(untwisted(turned, twist) - rotation.as_rotvec()).max() < 1e-9
    same = twisted(torch, torch.tensor(rotation.as_rotvec()), torch.tensor(twist))
    assert np.abs(same.numpy() - turned).max() < 1e-12


def test_encoding_inverts_decoding():
    rng = np.random.default_rng(1)
    inputs = np.column_stack([rng.uniform(1, 20, 30), rng.uniform(0.3, 3, 30), np.full(30, 1600.0)])
    raw = np.zeros((30, SLOW + 14))
    raw[:, : SLOW - 1] = rng.uniform(0.2, 1.0, (30, SLOW - 1))
    position, quaternion, force, twist = decode(np, inputs, raw)
    raw[:, 6:10] /= np.linalg.norm(raw[:, 6:10], axis=1, keepdims=True)
    back = encode(np, inputs, position, quaternion, force, twist)
    assert np.abs(back - raw[:, :SLOW]).max() < 1e-9


def test_a_rod_s_own_controller_is_accurate_on_fresh_grasps(made, controller):
    """300 grasps and 800 steps; the recipe has 6000."""
    inputs, grasps = held_out(60, seed=77, rod=ONE)
    figures = score(controller, inputs, grasps)
    assert figures["left_out"] == 0
    assert figures["mean_absolute_error"] < 4e-3
    # Those of a straight rod are more than an order further off.
    other = score(Controller.load(), inputs, grasps)
    assert other["mean_absolute_error"] > 10 * figures["mean_absolute_error"]
    *_, twist = controller.predict_with_twist(*inputs)
    assert np.abs(twist - grasps.twist).max() < 0.05 < np.ptp(grasps.twist)
    report = json.loads((made / "trained" / "controller.json").read_text())
    assert report["held_out"]["grasps"] == 40
    assert report["recipe"]["name"] == "curved"


def test_its_file_says_what_it_was_made_for(controller, tmp_path):
    left, up = controller.natural_curvature
    assert (left, up) == (pytest.approx(6.0 * ROD.gravito_bending_length), 0.0)
    assert controller.poisson == CURVED.poisson
    assert controller.range["suspended_length"][1] == pytest.approx(ONE.length)
    again = Controller.load(controller.save(tmp_path / "again.safetensors"))
    assert again.natural_curvature == (left, up)
    assert Controller.load().natural_curvature == (0.0, 0.0)
    damaged = {**controller.metadata, "rod": {"natural_curvature": [0.1]}}
    path = tmp_path / "damaged.safetensors"
    controller.metadata, kept = damaged, controller.metadata
    controller.save(path)
    controller.metadata = kept
    with pytest.raises(DataError, match=r"rod\.natural_curvature must be a list"):
        Controller.load(path)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_plans_to_either_side_are_those_of_the_rod_solver(controller, side):
    points = quarter_turn().sample(np.linspace(0.0, 0.12, 60))[0] * [1.0, side, 1.0]
    pattern = wrod.Pattern.from_points(points)
    numeric = wrod.plan(pattern, CURVED, "numeric", roll="plane", spacing=0.02, device="cpu")
    for method in ("neural", "auto"):
        neural = wrod.plan(
            pattern, CURVED, method, roll="plane", spacing=0.02, controller=controller
        )
        assert neural.metadata["closure"] == "zero_tension" and neural.shape is None
        lgb = CURVED.gravito_bending_length
        assert np.abs(neural.position - numeric.position).max() < 0.03 * lgb
        assert np.abs(neural.twist - numeric.twist).max() < 0.05
        assert np.abs(neural.rotation - numeric.rotation).max() < 0.1
        assert side * neural.twist[0] < -0.1


def test_where_it_was_not_trained_the_rod_solver_helps(controller):
    longer = replace(CURVED, length=0.3)
    pattern = quarter_turn()
    same = {"roll": "plane", "spacing": 0.02, "device": "cpu"}
    mixed = wrod.plan(pattern, longer, controller=controller, **same)
    numeric = wrod.plan(pattern, longer, "numeric", **same)
    assert np.abs(mixed.twist - numeric.twist).max() < 0.05
    # Beyond the controller's length they are the solver's own.
    assert np.abs(mixed.position[0] - numeric.position[0]).max() == 0.0
    assert np.abs(mixed.position[-1] - numeric.position[-1]).max() > 0.0


@pytest.mark.parametrize(
    "rod, roll, says",
    [
        (ROD, "plane", r"held with \(0, 0\)"),
        (replace(CURVED, natural_curvature=(0.0, 7.0)), "plane", r"held with \(0\.126, 0\)"),
        (CURVED, "up", r"held with \(0, 0\.108\)"),
        (replace(CURVED, poisson=0.3), "plane", "Poisson's ratio 0.5 and this one has 0.3"),
    ],
)
@pytest.mark.parametrize("method", ["auto", "neural"])
def test_other_rods_are_refused(controller, rod, roll, says, method):
    with pytest.raises(GraspError, match=says):
        wrod.plan(quarter_turn(), rod, method, roll=roll, controller=controller)


def test_a_controller_of_straight_rods_refuses_curved_ones():
    with pytest.raises(GraspError, match="made for naturally straight rods"):
        wrod.plan(quarter_turn(), CURVED, controller=Controller.load())
    with pytest.raises(GraspError, match="knows closure 'zero_tension' only"):
        wrod.plan(quarter_turn(), ROD, "neural", closure="min_force", controller=Controller.load())


def test_plan_command_takes_a_controller(made, tmp_path):
    args = ["plan", "line", "--rod", str(made / "rod.json"), "--length", "0.7", "--no-robot"]
    args += ["--roll", "plane", "--no-expect"]
    args += ["--controller", str(made / "trained"), "--no-shapes"]
    args += ["--spacing", "0.1", "--device", "cpu", "--json"]
    assert len(told(*args, "--out", tmp_path / "plan")["twist"]) == 2
    result = run(*args, "--rod", "green-vps", "--out", tmp_path / "no")
    assert result.exit_code == 2
    assert not (tmp_path / "no").exists()


def test_bends_without_grasps_are_out_of_range(tmp_path):
    """Bent against its own curvature by more than there are grasps for, the controller is mute."""
    from wrod.training import store
    from wrod.training.dataset import largest_curvature

    folder = tmp_path / "grasps"
    generate(folder, 12, shard_size=6, edge_count=32, rod=CURVED, device="cpu")
    assert largest_curvature(folder, 3.5) == 3.5
    manifest = store.read_manifest(folder)
    columns = store.read_shard(folder, manifest, 1)
    columns["converged"][2] = False
    store.write_shard(folder, manifest, 1, columns)
    assert largest_curvature(folder, 3.5) == pytest.approx(min(3.5, abs(columns["inputs"][2, 1])))


def test_recipes_learn_their_kind_of_rods_only(tmp_path):
    straight = GraspTable(np.ones((30, 3)), np.ones((30, 9)), None)
    with pytest.raises(DataError, match="recipe 'curved' does not learn; use recipe 'default'"):
        Training(recipe("curved"), straight, seed=0, device="cpu", folder=tmp_path)
    with pytest.raises(DataError, match="recipe 'paper' does not learn; use recipe 'curved'"):
        Training(recipe("paper"), straight, seed=0, device="cpu", folder=tmp_path, rod=ONE)


def test_table_of_a_curved_rod_has_the_twist_beside_the_rotation(made):
    table = load(made / "grasps")
    assert table.outputs.shape[1] == 10
    grasps = solve_grasps(*table.inputs[:4].T, natural_curvature=ONE.natural_curvature)
    assert table.outputs[:4, 9] == pytest.approx(grasps.twist)
    again = twisted(np, table.outputs[:4, 3:6], table.outputs[:4, 9])
    turn = Rotation.from_rotvec(again).inv() * Rotation.from_rotvec(grasps.rotation)
    assert turn.magnitude().max() < 1e-9
