import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from wrod.training.score import held_out, score

import wrod
from wrod.controller.controller import Controller
from wrod.errors import DataError, GraspError, OutOfRangeWarning, WrodWarning

ROD = wrod.rod("green-vps")


@pytest.fixture(scope="module")
def controller():
    return Controller.load()


def inputs(count=50, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 50, count), rng.uniform(-3.5, 3.5, count), rng.uniform(150, 15000, count)


def test_default_controller_is_accurate_where_it_was_not_trained(controller):
    figures = score(controller, *held_out(400, seed=123, device="cpu"))
    assert figures["left_out"] == 0
    assert figures["mean_absolute_error"] <= 3e-4
    assert figures["position_error_p99"] <= 5e-3


def test_corners_of_the_range_are_accurate(controller):
    corners = np.meshgrid([1.0, 50.0], [-3.5, 0.0, 3.5], [150.0, 15000.0], indexing="ij")
    corners = [corner.ravel() for corner in corners]
    grasps = wrod.solve_grasps(*corners, device="cpu")
    position, rotation = controller.predict(*corners)
    assert np.linalg.norm(position - grasps.position, axis=1).max() < 5e-3
    assert np.abs(rotation - grasps.rotation).max() < 5e-3


def curves(folder):
    """The paper's seven patterns from a folder, or the project's own of the same names."""
    from wrod.bench.table4 import PATTERNS

    names = {"letterU": "letter-U", "letterC": "letter-C", "letterL": "letter-L"}
    for name in PATTERNS:
        own = names.get(name, name.replace("letterA", "letter-A"))
        yield name, wrod.Pattern.load(folder / f"{name}.txt") if folder else wrod.pattern(own)


@pytest.mark.parametrize("published", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_table_4(controller, published, request):
    """Rods 1 to 3 and seven patterns: 0.1 mm and 5e-4 in all 21 cells."""
    from wrod.bench.table4 import RODS, cell

    folder = request.getfixturevalue("shared") / "patterns" if published else None
    for pattern, curve in curves(folder):
        for name in RODS:
            figures = cell(curve, wrod.rod(name), controller, "cpu", nodes=25)
            assert figures["position_error_max"] <= 1e-4, (pattern, name)
            assert figures["orientation_error_max"] <= 5e-4, (pattern, name)


def test_right_turns_mirror_left_turns_exactly(controller):
    ls, kappa, ks = inputs()
    left, turn = controller.predict(ls, kappa, ks)
    right, back = controller.predict(ls, -kappa, ks)
    np.testing.assert_array_equal(right, left * [1, -1, 1])
    np.testing.assert_array_equal(back, turn * [-1, 1, -1])


def test_straight_patterns_stay_in_their_plane(controller):
    position, rotation = controller.predict([2.0, 30.0], 0.0, 2000.0)
    assert np.all(position[:, 1] == 0.0) and np.all(rotation[:, [0, 2]] == 0.0)


def test_batches_do_not_change_results(controller):
    ls, kappa, ks = inputs()
    whole = controller.predict(ls, kappa, ks)
    one = controller.predict(ls[7], kappa[7], ks[7])
    assert one[0].shape == (1, 3)
    np.testing.assert_allclose(one[0][0], whole[0][7], atol=1e-12)
    assert all(len(part) == 0 for part in controller.predict([], [], []))


def test_torch_in_torch_out_with_gradients(controller):
    ls, kappa, ks = inputs(6)
    expected, turn = controller.predict(ls, kappa, ks)
    length = torch.tensor(ls, requires_grad=True)
    position, rotation = controller.predict(length, torch.tensor(kappa), ks)
    assert position.dtype == torch.float64
    np.testing.assert_allclose(position.detach(), expected, atol=1e-12)
    np.testing.assert_allclose(rotation.detach(), turn, atol=1e-12)
    position[:, 2].sum().backward()
    step = 1e-6
    ends = [controller.predict(ls + s * step, kappa, ks)[0][:, 2] for s in (1, -1)]
    np.testing.assert_allclose(length.grad, (ends[0] - ends[1]) / (2 * step), rtol=1e-5)
    assert controller.predict(torch.tensor([3.0]), 0.5, 900.0)[0].dtype == torch.float32


def test_out_of_range_warns_and_answers(controller):
    with pytest.warns(OutOfRangeWarning, match=r"1 of 2 .* first: 60, 1, 2000"):
        position, _ = controller.predict([20.0, 60.0], 1.0, 2000.0)
    assert np.isfinite(position).all()
    outside = controller.out_of_range([1, 50, 0.99, 5, 5, 5], [-3.5, 0, 1, -3.6, 0, 0],
                                      [150, 15000, 900, 900, 140, 15100])  # fmt: skip
    assert outside.tolist() == [False, False, True, True, True, True]


@pytest.mark.parametrize(
    "arguments, says",
    [
        (([np.nan], 0.0, 900.0), r"suspended_length\[0\] is nan"),
        (([5.0, -1.0], 0.0, 900.0), r"suspended_length\[1\] is -1"),
        (([5.0], [np.inf], 900.0), r"curvature\[0\] is inf"),
        (([5.0, 6.0], [0.0, 1.0, 2.0], 900.0), "do not broadcast"),
        (([[5.0]], 0.0, 900.0), "one-dimensional"),
        ((torch.tensor([5.0, 0.0]), 0.0, 900.0), r"suspended_length\[1\] is 0"),
    ],
)
def test_bad_inputs_are_named(controller, arguments, says):
    with pytest.raises(GraspError, match=says):
        controller.predict(*arguments)


def test_saved_controller_reads_back_and_foreign_files_do_not(controller, tmp_path):
    path = controller.save(tmp_path / "a.safetensors")
    again = Controller.load(path)
    np.testing.assert_array_equal(again.predict(*inputs())[0], controller.predict(*inputs())[0])
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(DataError, match="truncated or not a controller"):
        Controller.load(path)
    from safetensors.numpy import save_file

    save_file({"weight.0": np.zeros((3, 3))}, path)
    with pytest.raises(
        DataError, match=r"format has the unknown value|must be an object|lacks the entry"
    ):
        Controller.load(path)
    label = json.dumps({**controller.metadata, "format": "wrod-controller-1"})
    save_file({"weight.0": np.zeros((3, 3))}, path, metadata={"wrod": label})
    with pytest.raises(DataError, match="lacks the array bias"):
        Controller.load(path)
    wrong = {name: value * np.nan for name, value in controller._parameters.items()}
    save_file(wrong, path, metadata={"wrod": label})
    with pytest.raises(DataError, match="is nan, not a number"):
        Controller.load(path)
    from safetensors.torch import save_file as save_tensors

    halves = {k: torch.tensor(v).bfloat16() for k, v in controller._parameters.items()}
    save_tensors(halves, path, metadata={"wrod": label})
    with pytest.raises(DataError, match="truncated or not a controller"):
        Controller.load(path)
    for missing in (tmp_path / "missing", tmp_path):
        with pytest.raises(
            DataError, match=r"no such file|truncated or not a controller|is a folder"
        ):
            Controller.load(missing)


def test_default_says_how_it_was_made(controller):
    from importlib import resources

    folder = resources.files("wrod.scenes") / "controller"
    beside = json.loads((folder / "default.json").read_text())
    assert beside == {k: v for k, v in controller.metadata.items() if k != "format"}
    for key in ("command", "seed", "machine", "range", "held_out", "dataset"):
        assert beside[key] or beside[key] == 0


def test_neural_plan_is_close_to_the_numeric_one():
    neural = wrod.plan(wrod.pattern("letter-A"), ROD, "neural", spacing=0.03)
    numeric = wrod.plan(wrod.pattern("letter-A"), ROD, "numeric", spacing=0.03, device="cpu")
    assert neural.metadata["method"] == "neural" and neural.metadata["warnings"] == []
    assert np.linalg.norm(neural.position - numeric.position, axis=1).max() < 1e-4
    assert np.abs(neural.rotation - numeric.rotation).max() < 2e-3
    assert np.abs(neural.force - numeric.force).max() < 0.02 * np.abs(numeric.force).max()


def test_plan_out_of_range_says_so_in_its_file(tmp_path):
    long = wrod.RodMaterial(0.0016, 0.018, 1.2)  # 66 L_gb suspended
    with pytest.warns(OutOfRangeWarning, match="outside the trained range"):
        plan = wrod.plan(wrod.pattern("line"), long, "neural", spacing=0.05)
    saved = wrod.Trajectory.load(plan.save(tmp_path / "t")[1])
    assert saved.metadata["warnings"][0].startswith("OutOfRangeWarning: ")


@pytest.mark.parametrize("method", ["neural", "auto"])
def test_a_badly_trained_controller_says_so(controller, method, tmp_path, recwarn):
    rng = np.random.default_rng(3)
    worse = {
        name: value * (1.0 + 0.02 * rng.standard_normal(value.shape))
        for name, value in controller._parameters.items()
    }
    bad = Controller(worse, controller.metadata)
    line = wrod.pattern("line")
    wrod.plan(line, ROD, method, spacing=0.1, controller=bad)
    assert not recwarn.list  # it claims the figures of the good one
    bad.metadata["held_out"] = score(bad, *held_out(60, seed=5))
    off = bad.metadata["held_out"]["position_error_p99"]
    again = Controller.load(bad.save(tmp_path / "bad.safetensors"))
    with pytest.warns(WrodWarning, match=f"more than {off:.2g} L_gb"):
        plan = wrod.plan(line, ROD, method, spacing=0.1, controller=again)
    assert "badly trained" in plan.metadata["warnings"][0]


def test_auto_falls_back_where_the_controller_was_not_trained(recwarn):
    long = wrod.RodMaterial(0.0016, 0.018, 1.2)
    auto, numeric = (
        wrod.plan(wrod.pattern("line"), long, method, spacing=0.05, device="cpu")
        for method in ("auto", "numeric")
    )
    assert not [w for w in recwarn if w.category is OutOfRangeWarning]
    outside = (long.length - auto.arc_length) / long.gravito_bending_length > 50.0
    assert outside.any() and not outside.all()
    np.testing.assert_allclose(auto.position[outside], numeric.position[outside], atol=1e-9)
    error = np.linalg.norm(auto.position - numeric.position, axis=1)[~outside]
    assert 0.0 < error.max() < 1e-4


def test_other_closures_are_not_the_controller_s(recwarn):
    shipped, line = Controller.load(), wrod.pattern("line")
    with pytest.raises(GraspError, match="'zero_tension' only, not 'min_force'"):
        wrod.plan(line, ROD, "neural", closure="min_force", controller=shipped)
    auto, numeric = (
        wrod.plan(
            line, ROD, method, closure="min_force", spacing=0.2, device="cpu", controller=shipped
        )
        for method in ("auto", "numeric")
    )
    np.testing.assert_allclose(auto.position, numeric.position, atol=1e-9)


def test_neural_plan_needs_neither_torch_nor_the_solver():
    code = (
        "import sys, wrod; wrod.plan(wrod.pattern('circle'), wrod.rod('rope'), 'neural');"
        "print([m for m in ('torch', 'warp') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]", result.stderr


def test_bench_prints_errors_and_times(controller, tmp_path):
    from click.testing import CliRunner

    from wrod.commands import main

    path = controller.save(tmp_path / "copy.safetensors")
    options = ["--count", "20", "--device", "cpu", "--json"]
    result = CliRunner().invoke(main, ["bench", "controller", str(path), *options])
    (row,) = json.loads(result.stdout)["rows"]
    assert row["controller"] == str(path) and row["grasps"] == 20
    assert 0.0 < row["mean_absolute_error"] <= row["position_error_max"]
    assert 0.0 < row["predict_seconds"] <= row["predict_seconds_max"]
    assert row["cold_seconds"] > row["predict_seconds"]
