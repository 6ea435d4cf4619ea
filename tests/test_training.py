import json
import shutil
import time
from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from cli import refused, told
from click.testing import CliRunner
from forked import full_disk
from wrod.training.autograd import solve_grasps_differentiable
from wrod.training.dataset import GraspTable
from wrod.training.loop import CHECKPOINT, Training, errors
from wrod.training.network import GraspNetwork
from wrod.training.optimizer import Soap
from wrod.training.recipes import Recipe, recipe
from wrod.training.sampling import sample

from wrod.commands import main
from wrod.controller import model as controller_model
from wrod.controller.controller import Controller
from wrod.errors import DataError, GraspError
from wrod.grasps.optimal import solve_grasps

SMALL = Recipe(
    "small",
    "chain",
    16,
    batch=64,
    largest_batch=64,
    steps=60,
    depth=2,
    learning_rate=2e-2,
    validation_share=0.2,
)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def table():
    return GraspTable.solve(sample(0, 160, seed=0), "cpu")


def training(table, folder, recipe=SMALL, **options):
    return Training(recipe, table, seed=1, device="cpu", folder=folder, **options)


def test_gradients_through_the_solver():
    rng = np.random.default_rng(0)
    weights = [torch.tensor(rng.normal(size=(2, 3))) for _ in range(3)]
    start = [np.array([5.0, 22.0]), np.array([-1.2, 0.6]), np.array([500.0, 3000.0])]

    def objective(*inputs):
        outputs = solve_grasps_differentiable(*inputs)
        return sum((w * o).sum() for w, o in zip(weights, outputs, strict=True))

    tensors = [torch.tensor(value, requires_grad=True) for value in start]
    objective(*tensors).backward()
    for j, step in enumerate((1e-4, 1e-4, 1e-1)):
        for i in (0, 1):
            ends = []
            for sign in (1, -1):
                moved = [value.copy() for value in start]
                moved[j][i] += sign * step
                ends.append(float(objective(*map(torch.tensor, moved))))
            difference = (ends[0] - ends[1]) / (2 * step)
            assert tensors[j].grad[i].item() == pytest.approx(difference, rel=1e-4, abs=1e-7)


def test_solver_gradients_broadcast_and_keep_the_tensor_s_kind():
    length = torch.tensor([4.0, 9.0], dtype=torch.float32, requires_grad=True)
    position, rotation, _ = solve_grasps_differentiable(
        length, torch.tensor(0.7), torch.tensor(900.0)
    )
    assert position.dtype == rotation.dtype == torch.float32
    position[:, 2].sum().backward()
    assert torch.all(length.grad > 0.5)  # a longer rod is held higher
    none = solve_grasps_differentiable(torch.ones(0), torch.tensor(0.7), torch.tensor(900.0))
    assert [tuple(one.shape) for one in none] == [(0, 3)] * 3


def test_what_is_expanded_is_refused_before_it_takes_room():
    began, many = time.process_time(), torch.ones(1, 3).expand(2**31, 3)
    with pytest.raises(GraspError, match=r"broadcast to \(2147483648, 3\); give \(n,\)"):
        solve_grasps_differentiable(many, torch.tensor(0.7), torch.tensor(900.0))
    with pytest.raises(GraspError, match="finite"):
        nothing = torch.tensor(torch.nan).expand(9)
        solve_grasps_differentiable(nothing, torch.tensor(0.7), torch.tensor(900.0))
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("architecture", ["chain", "paper"])
def test_loss_matches_values_and_derivatives(table, tmp_path, architecture):
    """A table made from the network itself, with its exact Jacobian, costs nothing."""
    chosen = replace(SMALL, architecture=architecture, sensitivity_weight=0.5)
    run = training(table, tmp_path, chosen)
    inputs = run.inputs
    outputs = run.network(inputs).detach()
    known = outputs.shape[1]
    jacobian = torch.func.vmap(torch.func.jacrev(lambda x: run.network(x[None])[0]))(inputs)
    run.outputs[:, :known], run.sensitivity[:, :known] = outputs, jacobian.detach()
    rows, direction = torch.arange(len(inputs)), torch.randn(len(inputs), 3, dtype=torch.float64)
    assert run.loss(rows, direction).item() < 1e-20
    run.sensitivity[:, 2, 0] += 0.01
    # Per row, the error is 0.01 times the direction's l_s; the loss is half its mean square.
    expected = 0.5 * (0.01 * direction[:, 0] * inputs[:, 0]).square().mean()
    assert run.loss(rows, direction).item() == pytest.approx(expected.item(), rel=1e-6)


def test_training_lowers_the_error_and_writes_what_it_did(table, tmp_path):
    before = np.abs(errors(training(table, tmp_path).network, table)).mean()
    run = training(table, tmp_path, replace(SMALL, steps=300))
    run.run(watch_every=100)
    history = np.array(run.history)
    assert history[:, 0].tolist() == [100, 200, 300]
    assert history[-1, 2] < 0.2 * before
    lines = run.write_history(tmp_path / "history.csv").read_text().splitlines()
    assert lines[0].startswith("step,seconds,validation_mae") and len(lines) == 4


def test_resumed_training_gives_the_same_weights(table, tmp_path):
    whole = training(table, tmp_path / "whole")
    whole.run()
    first = training(table, tmp_path / "parts")
    first.recipe = SMALL
    steps = iter(range(10**6))
    original = first._one_step

    def stop_at_25(done):
        if next(steps) == 25:
            raise KeyboardInterrupt
        original(done)

    first._one_step = stop_at_25
    with pytest.raises(KeyboardInterrupt):
        first.run(checkpoint_every=0.0)
    second = training(table, tmp_path / "parts")
    assert second.resume() and second.step == 25
    second.run()
    for name, value in whole.network.arrays().items():
        np.testing.assert_array_equal(second.network.arrays()[name], value)


@pytest.mark.parametrize("kind", ["full", "vanished"])
def test_a_full_disk_or_a_folder_that_vanishes_loses_no_training(table, tmp_path, kind):
    whole = training(table, tmp_path / "whole")
    whole.run()
    run = training(table, tmp_path / "out")
    if kind == "full":
        steps, original = iter(range(10**6)), run._one_step
        with ExitStack() as later:

            def fill_at_25(done):
                if next(steps) == 25:
                    later.enter_context(full_disk(100))
                original(done)

            run._one_step = fill_at_25
            with pytest.raises(OSError, match=r"too large.*checkpoint"):
                run.run(checkpoint_every=0.0)
        assert [path.name for path in run.folder.iterdir()] == [CHECKPOINT]
        run = training(table, tmp_path / "out")
        assert run.resume() and run.step == 25
        run.run()
    else:

        def vanish(step, *_):
            if step % 20 == 5:
                shutil.rmtree(run.folder, ignore_errors=True)

        run.run(watch_every=1, progress=vanish)
        assert training(table, tmp_path / "out").resume()
    for name, value in whole.network.arrays().items():
        np.testing.assert_array_equal(run.network.arrays()[name], value)


def test_checkpoints_of_other_runs_and_damaged_ones_are_refused(table, tmp_path):
    run = training(table, tmp_path)
    assert not run.resume()
    path = run.checkpoint()
    with pytest.raises(DataError, match="another recipe, seed or dataset"):
        Training(SMALL, table, seed=2, device="cpu", folder=tmp_path).resume()
    content = bytearray(path.read_bytes())
    weights = next(iter(run.network.tensors().values())).detach().numpy().tobytes()
    content[content.index(weights)] ^= 1  # the file can be read, and says something else
    path.write_bytes(content)
    with pytest.raises(DataError, match="a checksum does not fit"):
        training(table, tmp_path).resume()
    path.write_bytes(content[:500])
    with pytest.raises(DataError, match="not a readable checkpoint"):
        training(table, tmp_path).resume()


def test_checkpoint_runs_no_code(table, tmp_path):
    import pickle

    class Bad:
        def __reduce__(self):
            return print, ("executed",)

    (tmp_path / CHECKPOINT).write_bytes(pickle.dumps(Bad()))
    with pytest.raises(DataError, match="not a readable checkpoint"):
        training(table, tmp_path).resume()


def test_new_samples_are_asked_for_where_the_error_is_and_survive_a_resume(table, tmp_path):
    asked = []

    def solve(inputs):
        asked.append(inputs)
        return GraspTable.solve(inputs, "cpu")

    run = training(table, tmp_path, refine=20, solve=solve)
    run.run()
    assert [len(inputs) for inputs in asked] == [10, 10]
    assert len(run.learning) == 128 + 20 and len(run.inputs) == 148
    again = training(table, tmp_path, refine=20, solve=solve)
    assert again.resume()
    np.testing.assert_array_equal(again.learning.inputs, run.learning.inputs)
    assert not np.isin(asked[0][:, 0], table.inputs[:, 0]).any()


def test_paper_recipe_alternates_grows_and_ends_on_all_data(table, tmp_path):
    chosen = replace(recipe("paper"), width=32, steps=30, batch=16, largest_batch=64, all_below=9.0)
    run = training(table, tmp_path, chosen)
    run.best = 0.0  # every validation is a stall
    run.run(watch_every=1)
    assert run.uses_all and len(run.inputs) == len(table)
    batches = [row[4] for row in run.history]
    assert batches[0] == 16 and batches[-1] == 64 and sorted(batches) == batches
    rates = {row[3] for row in run.history}
    assert len(rates) == 2  # Adam's and SGD's


def test_paper_network_is_the_paper_s(table):
    chosen = recipe("paper")
    network = GraspNetwork(
        chosen.architecture, chosen.width, chosen.depth, table, torch.Generator()
    )
    assert [tuple(w.shape) for w in network.weights] == [
        (392, 3), (392, 392), (392, 392), (392, 392), (6, 392),
    ]  # fmt: skip
    np.testing.assert_allclose(network.mean, table.inputs.mean(axis=0))


@pytest.mark.parametrize(
    "columns",
    [controller_model.OUTPUTS, controller_model.WITH_THRUST, controller_model.WITH_PULL],
)
def test_encoding_inverts_decoding(table, columns):
    rng = np.random.default_rng(0)
    inputs = table.inputs[table.inputs[:, 1] > 0.05]
    raw = rng.uniform(0.2, 1.0, (len(inputs), columns))
    position, quaternion, force = controller_model.decode(np, inputs, raw)
    # Quaternions come back normalised.
    odd = inputs[:, 1] / np.hypot(1.0, inputs[:, 1])
    size = np.sqrt(raw[:, 5] ** 2 + raw[:, 7] ** 2 + odd**2 * (raw[:, 6] ** 2 + raw[:, 8] ** 2))
    raw[:, 5:9] /= size[:, None]
    back = controller_model.encode(np, inputs, position, quaternion, force, columns)
    if columns == controller_model.WITH_PULL:  # of which two parts count as their sum
        for found, given in zip(
            controller_model.decode(np, inputs, back), (position, quaternion, force), strict=True
        ):
            np.testing.assert_allclose(found, given, atol=1e-9)
        back, raw = back[:, :9], raw[:, :9]
    np.testing.assert_allclose(back, raw, atol=1e-9)


def test_long_rods_hang_as_chains(table):
    """What the network adds to the chain stays bounded; the chain grows with the rod."""
    inputs = np.array([[ls, 2.0, 1000.0] for ls in (30.0, 40.0, 50.0)])
    grasps = solve_grasps(*inputs.T)
    _, y, z = controller_model.end_of_chain(np, inputs, grasps.force)
    beyond = np.stack([grasps.position[:, 1] - y, grasps.position[:, 2] - z], axis=1)
    assert np.ptp(grasps.position[:, 2]) > 15.0
    assert np.abs(beyond).max() < 1.0 and np.ptp(beyond, axis=0).max() < 0.05


def test_soap_beats_adam_where_axes_are_mixed():
    """A least-squares problem of condition 1e6 in turned axes."""
    generator = torch.Generator().manual_seed(0)
    basis = torch.linalg.qr(torch.randn(16, 16, generator=generator, dtype=torch.float64))[0]
    scale = torch.logspace(0, -3, 16, dtype=torch.float64)
    inputs = (basis * scale) @ basis.T
    target = torch.randn(16, 4, generator=generator, dtype=torch.float64)
    ends = []
    for kind in (Soap, torch.optim.Adam):
        weight = torch.zeros(16, 4, dtype=torch.float64, requires_grad=True)
        optimizer = kind([weight], lr=1e-2)
        for step in range(600):
            optimizer.param_groups[0]["lr"] = 3e-2 * (1.0 - step / 600)
            loss = (inputs @ (weight - target)).square().sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        ends.append(loss.item())
    assert ends[0] < 0.1 * ends[1]


def test_train_from_nothing_is_one_command_that_resumes(tmp_path):
    arguments = [
        "train", "--generate", "120", "--out", str(tmp_path), "--steps", "40", "--width", "16",
        "--test", "20", "--device", "cpu", "--json",
    ]  # fmt: skip
    report = told(*arguments)
    assert report["samples"] == 120 and not report["resumed"]
    assert report["held_out"]["grasps"] == 20 and report["held_out"]["left_out"] == 0
    controller = Controller.load(tmp_path / "controller.safetensors")
    assert controller.metadata["seed"] == 0 and controller.closure == "zero_tension"
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {
        "controller.safetensors", "controller.json", "history.csv", CHECKPOINT, "dataset",
    }  # fmt: skip
    again = json.loads(CliRunner().invoke(main, arguments).stdout)
    assert again["resumed"] and again["validation"] == report["validation"]


@pytest.mark.parametrize("source", [["--generate", "100"], ["--dataset", "ready"]])
def test_out_that_cannot_be_written_is_said_before_training(tmp_path, monkeypatch, source, table):
    from wrod.training import dataset, store

    monkeypatch.setattr(dataset, "load", lambda folder, most: table)
    monkeypatch.setattr(
        store, "read_manifest", lambda folder: SimpleNamespace(rod_inputs=None, size=100)
    )
    (tmp_path / "file").touch()
    trained = []
    monkeypatch.setattr(Training, "run", lambda self, **options: trained.append(self))
    out = str(tmp_path / "file" / "out")
    refused("cannot be written", "train", *source, "--out", out, "--device", "cpu")
    assert not trained


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "either --dataset DIR or --generate N"),
        (["--dataset", "nowhere"], "give the manifest that `wrod dataset` writes"),
        (["--generate", "200", "--recipe", "best"], "use one of default, curved, paper"),
    ],
)
def test_bad_options_are_one_sentence(tmp_path, arguments, says):
    refused(says, "train", "--out", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()
