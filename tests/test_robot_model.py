import math
import shutil
import struct
import subprocess

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from wrod.scenes import sawyer

from wrod.errors import RobotError, WrodWarning
from wrod.robot.kinematics import grasp_poses, one_torch_thread, pose_error, solve_poses
from wrod.robot.model import ROBOTS, load_robot
from wrod.robot.urdf import read_urdf

# The manufacturer's table, typed again: xyz [m] and roll, pitch, yaw [rad] of j0 ... j6.
TABLE = [
    ((0, 0, 0.08), (0, 0, 0)),
    ((0.081, 0.05, 0.237), (-math.pi / 2, math.pi / 2, 0)),
    ((0, -0.14, 0.1425), (math.pi / 2, 0, 0)),
    ((0, -0.042, 0.26), (-math.pi / 2, 0, 0)),
    ((0, -0.125, -0.1265), (math.pi / 2, 0, 0)),
    ((0, 0.031, 0.275), (-math.pi / 2, 0, 0)),
    ((0, -0.11, 0.1053), (-math.pi / 2, -0.17453, 3.1416)),
]
NEUTRAL = (0, -1.18, 0, 2.18, 0, 0.57, 3.3161)


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def composed(positions, gripper_length):
    """Links l0 ... l6 and the grasp: each joint is xyz, Rz(yaw) Ry(pitch) Rx(roll), Rz(q)."""
    origin, turn, links = np.zeros(3), np.eye(3), []
    for (xyz, (roll, pitch, yaw)), angle in zip(TABLE, positions, strict=True):
        origin = origin + turn @ np.array(xyz, float)
        turn = turn @ rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch)
        turn = turn @ rotation((1, 0, 0), roll) @ rotation((0, 0, 1), angle)
        links.append((origin, turn))
    turn = turn @ rotation((0, 0, 1), math.pi / 2)
    links.append((origin + turn @ [0, 0, 0.0245 + gripper_length], turn))
    return links


@pytest.fixture(scope="module")
def robot():
    return load_robot("sawyer")


def random_positions(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, 7))


def test_forward_kinematics_is_the_table(robot):
    positions = np.vstack([NEUTRAL, np.zeros(7), random_positions(robot, 30)])
    poses = robot.link_poses(positions)
    names = [f"right_l{i}" for i in range(7)] + ["grasp"]
    for row, q in enumerate(positions):
        for name, (origin, turn) in zip(names, composed(q, 0.15), strict=True):
            pose = poses[name][row]
            assert np.abs(pose[:3, 3] - origin).max() < 1e-6
            angle = Rotation.from_matrix(pose[:3, :3].T @ turn).magnitude()
            assert angle < 1e-6


def test_limits_and_order_are_the_manufacturers(robot):
    assert robot.joint_names == tuple(f"right_j{i}" for i in range(7))
    assert robot.lower[1] == -3.8095 and robot.upper[1] == 2.2736
    assert robot.velocity.tolist() == [1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545]


@pytest.mark.parametrize("length", [0.12, 0.3])
def test_gripper_length_moves_the_grasp_along_the_fingers(length):
    arm = load_robot("sawyer", gripper_length=length)
    pose = grasp_poses(arm, np.array([NEUTRAL]))[0]
    origin, turn = composed(NEUTRAL, length)[-1]
    assert np.abs(pose[:3, 3] - origin).max() < 1e-6
    assert np.abs(pose[:3, :3] - turn).max() < 1e-6


def test_jacobian_is_the_derivative_of_the_pose(robot):
    import torch

    with one_torch_thread():
        q = torch.from_numpy(random_positions(robot, 5, seed=3))
        jacobian, pose = robot.jacobian(q)
        step = 1e-6
        for joint in range(7):
            ahead = q.clone()
            ahead[:, joint] += step
            there = robot.jacobian(ahead)[1]
            assert (pose_error(pose, there) / step - jacobian[:, :, joint]).abs().max() < 1e-5


@pytest.mark.parametrize("name", ROBOTS)
def test_jacobian_is_that_of_the_whole_chain(name):
    import torch

    arm = load_robot(name)
    q = np.random.default_rng(4).uniform(-3.0, 3.0, (5, len(arm.joint_names)))
    q = torch.from_numpy(q).requires_grad_()
    own, whole = arm.jacobian(q), arm.chain.jacobian_tensor(q, ret_eef_pose=True)
    for a, b in zip(own, whole, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=1e-13)
    slopes = [torch.autograd.grad(one[1].square().sum(), q)[0] for one in (own, whole)]
    torch.testing.assert_close(*slopes, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["sawyer", "ur5e", "gen3"])  # the last has joints without limits
def test_inverse_kinematics_finds_reachable_poses(name):
    robot = load_robot(name)
    lower, upper = np.maximum(robot.lower, -4.0), np.minimum(robot.upper, 4.0)
    seeds = np.random.default_rng(5).uniform(0.6 * lower, 0.6 * upper, (16, len(lower)))
    with one_torch_thread():
        targets = grasp_poses(robot, seeds[:4])
        solved, converged = solve_poses(robot, targets, seeds[4:])
        assert converged.sum(1).min() > 2
        assert (solved >= robot.lower).all() and (solved <= robot.upper).all()
        for target, rows, good in zip(targets, solved, converged, strict=True):
            assert np.abs(grasp_poses(robot, rows[good]) - target).max() < 1e-3


def test_shipped_file_is_what_the_tables_write():
    assert sawyer.PATH.read_text(encoding="utf-8") == sawyer.sawyer_urdf()


@pytest.mark.skipif(shutil.which("check_urdf") is None, reason="liburdfdom-tools is not installed")
def test_standard_checker_accepts_the_file():
    checked = subprocess.run(["check_urdf", sawyer.PATH], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stderr
    assert "Successfully Parsed XML" in checked.stdout


def test_newton_reads_the_file_and_agrees(robot):
    newton = pytest.importorskip("newton")
    builder = newton.ModelBuilder()
    builder.add_urdf(str(sawyer.PATH), floating=False)
    model = builder.finalize(device="cpu")
    state = model.state()
    labels = [label.split("/")[-1] for label in model.joint_label]
    joint_q = model.joint_q.numpy()
    starts = model.joint_q_start.numpy()
    for name, angle in zip(robot.joint_names, NEUTRAL, strict=True):
        joint_q[starts[labels.index(name)]] = angle
    model.joint_q.assign(joint_q)
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    bodies = [label.split("/")[-1] for label in model.body_label]
    poses = robot.link_poses(NEUTRAL)
    poses["grasp"] = grasp_poses(robot, np.reshape(NEUTRAL, (1, -1)))
    for link in ("right_l3", "right_l6", "head", "grasp"):
        place = state.body_q.numpy()[bodies.index(link), :3]
        assert np.abs(place - poses[link][0, :3, 3]).max() < 1e-5  # Newton is float32


# A user's own arm: six joints, a mesh, no gripper.
def own_arm(folder, mesh="meshes/tool.stl", **changes):
    joints = "".join(
        f"""<joint name="a{i}" type="revolute"><parent link="k{i}"/><child link="k{i + 1}"/>
        <origin xyz="0.03 0 0.2" rpy="{math.pi / 2 * (-1) ** i if i in (1, 3, 4, 5) else 0} 0 0"/>
        <axis xyz="0 0 1"/>{'<limit lower="-3" upper="3" velocity="2" effort="9"/>'}</joint>"""
        for i in range(6)
    )
    links = "".join(f'<link name="k{i}"/>' for i in range(6))
    text = f"""<robot name="own">{links}<link name="k6"><visual><geometry>
        <mesh filename="{mesh}" scale="0.001 0.001 0.001"/></geometry></visual><collision>
        <geometry><mesh filename="{mesh}" scale="0.001 0.001 0.001"/></geometry></collision></link>
        {joints}</robot>"""
    for old, new in changes.items():
        text = text.replace(old, new)
    (folder / "meshes").mkdir(exist_ok=True)
    corners = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 60]], np.float32)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    data = b"\0" * 80 + struct.pack("<I", len(faces))
    for face in faces:
        data += np.zeros(3, np.float32).tobytes() + corners[list(face)].tobytes() + b"\0\0"
    (folder / "meshes" / "tool.stl").write_bytes(data)
    path = folder / "own.urdf"
    path.write_text(text)
    return path


def test_own_urdf_gets_the_gripper_on_its_last_link(tmp_path):
    import torch

    arm = load_robot(own_arm(tmp_path))
    assert arm.joint_names == tuple(f"a{i}" for i in range(6))
    poses = arm.link_poses(np.zeros((1, 6)))
    relative = np.linalg.inv(poses["k6"][0]) @ poses["grasp"][0]
    assert np.abs(relative[:3, 3] - [0, 0, 0.15]).max() < 1e-6
    from wrod.robot.collision import CollisionModel

    model = CollisionModel(arm)
    mine = [k for k, link in enumerate(model.links) if link == "k6"]
    corners = 1e-3 * np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 60]])
    weights = np.random.default_rng(1).dirichlet(np.ones(4), 2000)
    still = torch.zeros((1, 6), dtype=torch.float64)
    back = np.linalg.inv(poses["k6"][0])
    start, end = (
        ends[0, mine].numpy() @ back[:3, :3].T + back[:3, 3]
        for ends in model.points(arm.jacobian.frames(still))
    )
    radius = model.radius[mine]
    assert covers(start, end, radius, weights @ corners)
    # ... and not much more: a hundredth of a litre of tetrahedron in capsules of a few.
    volume = (np.pi * radius**2 * (np.linalg.norm(end - start, axis=1) + 4 / 3 * radius)).sum()
    assert volume < 12 * 0.03 * 0.03 * 0.06 / 6


def covers(start, end, radius, points):
    """Whether every point is in one of the capsules."""
    axis = end - start
    share = np.einsum("nkx,kx->nk", points[:, None] - start, axis)
    share = np.clip(share / np.maximum((axis**2).sum(1), 1e-12), 0, 1)
    off = np.linalg.norm(points[:, None] - start - share[..., None] * axis, axis=2)
    return bool((off <= radius + 1e-6).any(1).all())


@pytest.mark.parametrize(
    "changes, says",
    [
        ({'<parent link="k2"/>': '<parent link="elbow"/>'}, "parent link 'elbow'"),
        ({"</robot>": ""}, "not readable as XML"),
        ({"<robot": "<model", "</robot>": "</model>"}, "not <robot>"),
        ({"meshes/tool.stl": "meshes/gone.stl"}, "mesh 'meshes/gone.stl' is missing"),
        ({'lower="-3" ': ""}, "joint 'a0' has no position limits"),
        ({'<parent link="k2"/>': '<parent link="k2"/><mimic joint="a0"/>'}, "mimics another"),
        ({'velocity="2"': 'velocity="0"'}, "joint 'a0' has no velocity limit"),
        ({'type="revolute"><parent link="k5"': 'type="fixed"><parent link="k5"'}, "needs six"),
        ({'<link name="k0"/>': '<link name="k0"/><link name="lost"/>'}, "2 links have no parent"),
    ],
)
def test_broken_urdf_is_named(tmp_path, changes, says):
    with pytest.raises(RobotError, match=r"own\.urdf") as error:
        load_robot(own_arm(tmp_path, **changes))
    assert says in str(error.value)


def test_velocity_limits_that_say_there_is_none(tmp_path):
    """Makers' files have 10000 rad/s, of a head that no path needs, too."""
    arm = load_robot(own_arm(tmp_path, **{'velocity="2"': 'velocity="10000"'}))
    assert arm.velocity[0] == 10000.0
    with pytest.raises(RobotError, match=r"limit is 1e\+06; give 0.001 to 100000 rad"):
        load_robot(own_arm(tmp_path, **{'velocity="2"': 'velocity="1000000"'}))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({'lower="-3"': 'lower="-170"'}, "'a0' turns to 170 rad"),
        ({'velocity="2"': 'velocity="180"'}, "'a0' may turn by 180 rad/s"),
        ({'rpy="0 0 0"': 'rpy="0 90 0"'}, "'a0' is rotated by 90 rad"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*degrees")  # of its other joints
def test_degrees_are_asked_after(tmp_path, changes, says):
    with pytest.warns(WrodWarning, match=rf"{says} \(degrees\?\)"):
        load_robot(own_arm(tmp_path, **changes))


def test_missing_file_link_and_name(tmp_path):
    with pytest.raises(RobotError, match="no such file"):
        load_robot(tmp_path / "arm.urdf")
    with pytest.raises(RobotError, match="unknown robot 'baxter'; known robots: sawyer"):
        load_robot("baxter")
    with pytest.raises(RobotError, match="no link 'wrist' for the gripper's flange; its links are"):
        load_robot("sawyer", flange="wrist")
    with pytest.raises(RobotError, match=r"gripper length is 0\.01"):
        load_robot("sawyer", gripper_length=0.01)


def test_a_mesh_of_many_million_triangles_is_not_read(tmp_path):
    from wrod.robot.mesh import read_mesh

    with open(tmp_path / "a.stl", "wb") as file:
        file.truncate(65 * 2**20)
    with pytest.raises(RobotError, match=r"a.stl: has 65 MiB, and at most 64 MiB are read"):
        read_mesh(tmp_path / "a.stl")


def test_package_meshes_are_found_beside_the_urdf(tmp_path):
    folder = tmp_path / "own_description"
    folder.mkdir()
    path = own_arm(folder, mesh="package://own_description/meshes/tool.stl")
    assert read_urdf(path).shapes("visual")[0].mesh == folder / "meshes" / "tool.stl"


def test_mesh_arm_goes_through_path_and_scene(tmp_path, letter, letter_path):
    """A Sawyer whose forearm is a mesh, as the manufacturer's file has it."""
    import wrod
    from wrod.scene.validate import open_stage, validation_errors

    own_arm(tmp_path)  # for its mesh
    mesh = '<mesh filename="meshes/tool.stl" scale="0.003 0.003 0.003"/>'
    text = sawyer.PATH.read_text(encoding="utf-8")
    link = text.index('<link name="right_l4">') + len('<link name="right_l4">')
    text = text[:link] + f"<visual><geometry>{mesh}</geometry></visual>" + text[link:]
    (tmp_path / "mesh.urdf").write_text(text)
    path = wrod.solve_joint_path(
        letter, robot=tmp_path / "mesh.urdf", placement=letter_path.placement
    )
    assert np.abs(path.positions - letter_path.positions).max() < 1.0
    scene = wrod.export_usd(tmp_path / "s.usdc", trajectory=letter, joint_path=path)
    assert validation_errors(scene) == []
    stage = open_stage(scene)
    from pxr import UsdGeom

    shown = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    assert shown.GetParent().GetName() == "right_l4"
    extent = np.array(UsdGeom.Mesh(shown).GetExtentAttr().Get())
    assert np.abs(extent[1] - [0.09, 0.09, 0.18]).max() < 1e-6
