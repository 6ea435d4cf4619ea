"""The examples of this folder beside other solvers' cables: error, and time of a frame, in one run.

Six of them are stated for Newton's SolverVBD too: the same cables, as `newton.Rod`, on the mesh of
the example, ten steps a frame; the bundle's without Dahl's friction. It moves no arm. Where
dismech-newton is installed, it runs four of them, in as many steps.

Run: `python examples/newton/beside_vbd.py [--device cuda:0] [--iterations 20] [EXAMPLE...]`
"""

import argparse
import importlib
import importlib.util
import sys
import time
import warnings
from pathlib import Path

import newton
import numpy as np
import warp as wp
from newton.viewer import ViewerNull
from scipy.spatial.transform import Rotation
from vbd_scene import FRAME, Vbd

from wrod.bench.newton_piles import deepest_of
from wrod.machine import machine_line


def lines_of(example) -> list[np.ndarray]:
    der, q = example.model.der, example.state.der.node_q.numpy().astype(float)
    spans = zip(der.rod_first_node.numpy(), der.rod_node_count.numpy(), strict=True)
    return [q[first : first + count] for first, count in spans]


def der_error(name: str, e, module, args) -> float:
    """What an example of SolverDER misses at its end, see `WHAT`."""
    if name == "crane":
        return float(np.linalg.norm(place_of_beam(e) - fine(module, args, place_of_beam))) / 0.4
    if name == "arm_carries_cable":
        return abs(e.hanging[0] / e.hanging[1] - 1.0)
    if name == "gripper_picks_cable":
        return float(np.abs(e.hanging[0][module.BEAR] / e.hanging[1][module.BEAR] - 1.0).max())
    if name == "y_junction":
        return float(np.abs(tips_of(e) - fine(module, args, tips_of)).max()) / module.BRANCH
    if name == "twist_transfer":
        return max(
            abs(wrapped(e.angle(k, module.EDGES - 1) - e.angle(k, 0)))
            for k in range(len(module.YOUNGS))
        )
    radius = module.RADIUS
    return e.deepest / radius


WHAT = {
    "crane": "place of the beam at the end over 0.4 m, from a mesh three times as fine",
    "cable_pile": "deepest overlap over the radius",
    "arm_carries_cable": "torque of the shoulder, relative",
    "gripper_picks_cable": "torques of the arm, relative",
    "y_junction": "tips at the end over a branch, from a mesh three times as fine",
    "twist_transfer": "turn that does not arrive [rad]",
    "bundle_hysteresis": "deepest overlap over the radius",
    "plectoneme": "deepest overlap over the radius",
}


def wrapped(angle: float) -> float:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def tips_of(example) -> np.ndarray:
    lines = lines_of(example)
    return np.array([lines[k][-1] for k in example.rods[1:]])


def place_of_beam(example) -> np.ndarray:
    return example.state.body_q.numpy()[example.beam, :3].astype(float)


def fine(module, args, result):
    """Result of an example at its end on a mesh three times as fine."""
    coarse, module.EDGES = module.EDGES, 3 * module.EDGES
    example = module.Example(ViewerNull(num_frames=1), args)
    for _ in range(example.frame_count):
        example.step()
    module.EDGES = coarse
    return result(example)


def run(frames: int, step, device) -> float:
    """Milliseconds of a frame, but for the first two: of a core, or by the clock on a GPU."""
    now = time.process_time if wp.get_device(device).is_cpu else time.perf_counter
    step(1), step(2)
    wp.synchronize()
    start = now()
    for k in range(3, frames + 1):
        step(k)
    wp.synchronize()
    return 1e3 * (now() - start) / (frames - 2)


def pile(solver, module, args) -> tuple[float, float]:
    scene, deepest = solver(args, 0.5), [0.0]
    scene.builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(ke=1e5, kd=0.0, mu=0.6))
    made = module.Example(ViewerNull(num_frames=1), args)
    m = made.material
    for points in lines_of(made):
        scene.add(points, m.youngs_modulus, m.radius, m.weight / m.gravity, damping=0.005, mu=0.4)
    scene.begin()

    def step(k: int) -> None:
        scene.step()
        deepest[0] = max(deepest[0], scene.deepest(m.radius))

    took = run(module.Example.frame_count, step, args.device)
    return deepest[0], took


def crane(solver, module, args) -> tuple[float, float]:
    made = module.Example(ViewerNull(num_frames=1), args)
    scene, m = solver(args, 0.3), made.material
    poses = made.model.body_q.numpy()
    hook = scene.builder.add_body(xform=poses[made.hook], mass=1.0)
    beam = scene.builder.add_body(
        xform=poses[made.beam], mass=module.MASS,
        inertia=wp.mat33(made.model.body_inertia.numpy()[made.beam]),
    )  # fmt: skip
    for points in lines_of(made):
        bodies = scene.add(points, m.youngs_modulus, m.radius, m.weight / m.gravity, damping=0.01)
        half = 0.5 * np.linalg.norm(points[1] - points[0])
        scene.builder.add_joint_ball(hook, bodies[0], child_xform=wp.transform((0.0, 0.0, -half)))
        on_beam = points[-1] - place_of_beam(made)
        scene.builder.add_joint_ball(
            bodies[-1], beam, parent_xform=wp.transform((0.0, 0.0, half)),
            child_xform=wp.transform(tuple(on_beam)),
        )  # fmt: skip
    scene.begin([hook])

    def step(k: int) -> None:
        way = module.smooth(k * FRAME / module.MOVING)
        at = made.start + [module.ASIDE * way, 0.0, module.LIFT * way]
        scene.step({hook: [*at, 0.0, 0.0, 0.0, 1.0]})

    took = run(module.Example.frame_count, step, args.device)
    place = scene.state.body_q.numpy()[beam, :3].astype(float)
    return float(np.linalg.norm(place - fine(module, args, place_of_beam))) / 0.4, took


def bundle(solver, module, args) -> tuple[float, float]:
    """The cables without Dahl's friction."""
    made, deepest = module.Example(ViewerNull(num_frames=1), args), [0.0]
    scene, radius = solver(args, 3.0, 0.0), module.RADIUS
    for points in lines_of(made)[:-1]:
        scene.add(points, 0.04 / (np.pi * radius**4), radius, 0.055, damping=0.02, mu=0.3)
    poses = made.model.body_q.numpy()
    pegs = [scene.builder.add_body(xform=poses[peg], mass=1.0) for peg in made.pegs]
    cfg = newton.ModelBuilder.ShapeConfig(ke=1e5, kd=0.0, mu=0.0)
    for peg in pegs:
        scene.builder.add_shape_capsule(peg, radius=module.PEG, half_height=0.06, cfg=cfg)
    scene.begin(pegs)

    def step(k: int) -> None:
        t = k * FRAME
        way = module.smooth(t / module.PRESSING)
        way -= module.smooth((t - module.PRESSING - module.HOLDING) / module.LEAVING)
        places = poses[made.pegs].copy()
        places[:, 1] = made.sides * (module.AWAY - (module.AWAY + module.PRESS) * way)
        scene.step(dict(zip(pegs, places, strict=True)))
        deepest[0] = max(deepest[0], scene.deepest(radius))

    took = run(module.Example.frame_count, step, args.device)
    return deepest[0], took


def junction(solver, module, args) -> tuple[float, float]:
    nodes, edges = [np.array([0.0, 0.0, module.HEIGHT])], []
    for branch in range(3):
        turn = branch * module.THIRD
        for k in range(1, module.EDGES + 1):
            edges.append((0 if k == 1 else len(nodes) - 1, len(nodes)))
            way = np.array([np.cos(turn), np.sin(turn), 0.0]) * module.BRANCH * k / module.EDGES
            nodes.append(nodes[0] + way)
    scene = solver(args, 3.0)
    mass = module.DENSITY * np.pi * module.RADIUS**2
    bodies = scene.add(nodes, module.YOUNG, module.RADIUS, mass, damping=0.02, edges=edges)
    half = 0.5 * module.BRANCH / module.EDGES
    scene.builder.add_joint_ball(
        -1, bodies[module.EDGES - 1], parent_xform=wp.transform(tuple(nodes[module.EDGES])),
        child_xform=wp.transform((0.0, 0.0, half)),
    )  # fmt: skip
    scene.begin()
    took = run(module.Example.frame_count, lambda k: scene.step(), args.device)
    ends = scene.ends(0)[[2 * module.EDGES - 1, 3 * module.EDGES - 1], 1]
    return float(np.abs(ends - fine(module, args, tips_of)).max()) / module.BRANCH, took


def twist(solver, module, args) -> tuple[float, float]:
    scene, held = solver(args, 2.0, 0.0), []
    made = module.Example(ViewerNull(num_frames=1), args)
    for k, young in enumerate(module.YOUNGS):
        m = made.materials[k]
        bodies = scene.add(
            made.circles[k], young, module.RADIUS, m.weight / m.gravity, damping=0.02
        )
        held.append(bodies[0])
        scene.guide(bodies[-1])
    scene.begin(held)
    first = scene.state.body_q.numpy().astype(float)

    def turned(body: int) -> Rotation:
        now = scene.state.body_q.numpy()[body, 3:].astype(float)
        return Rotation.from_quat(first[body, 3:]).inv() * Rotation.from_quat(now)

    def step(k: int) -> None:
        angle = module.TURN * module.smooth(k * FRAME / module.MOVING)
        poses = {}
        for body in held:
            turn = Rotation.from_quat(first[body, 3:]) * Rotation.from_rotvec([0.0, 0.0, angle])
            poses[body] = [*first[body, :3], *turn.as_quat()]
        scene.step(poses)

    took = run(module.Example.frame_count, step, args.device)
    came = [turned(bodies[-1]).as_rotvec()[2] for bodies in scene.bodies]
    return max(abs(wrapped(c - module.TURN)) for c in came), took


def plectoneme(solver, module, args) -> tuple[float, float]:
    made = module.Example(ViewerNull(num_frames=1), args)
    (points,) = lines_of(made)
    young, radius, deepest = 2e7, module.RADIUS, [0.0]
    scene = solver(args, 4.0, 0.0)
    bodies = scene.add(points, young, radius, 1150.0 * np.pi * radius**2, damping=0.01, mu=0.1)
    scene.begin([bodies[0], bodies[-1]])
    first = scene.state.body_q.numpy().astype(float)

    def step(k: int) -> None:
        t = k * FRAME
        angle = 2.0 * np.pi * module.TURNS * module.smooth((t - module.NEARING) / module.TURNING)
        last = first[bodies[-1]].copy()
        last[0] -= module.SLACK * module.smooth(t / module.NEARING)
        turn = Rotation.from_rotvec([angle, 0.0, 0.0]) * Rotation.from_quat(last[3:])
        scene.step({bodies[0]: first[bodies[0]], bodies[-1]: [*last[:3], *turn.as_quat()]})
        deepest[0] = max(deepest[0], inside_itself(scene.line(0), radius))

    took = run(module.Example.frame_count, step, args.device)
    return deepest[0], took


def inside_itself(q: np.ndarray, radius: float) -> float:
    """Deepest overlap over the radius of pieces farther apart along the cable than half a turn of
    its tightest bend."""
    edge = np.linalg.norm(np.diff(q, axis=0), axis=1).mean()
    apart = int(np.ceil(np.pi * radius / edge)) + 1
    pieces = [(q[k : k + 2], q[k + apart + 1 :]) for k in range(len(q) - apart - 2)]
    return max(deepest_of([a, b], radius) for a, b in pieces)


SCENES = {
    "crane": crane, "cable_pile": pile, "y_junction": junction, "twist_transfer": twist,
    "bundle_hysteresis": bundle, "plectoneme": plectoneme,
}  # fmt: skip
# What `dismech_scene` can state: chains without bodies that move by forces.
CHAINS = ("cable_pile", "twist_transfer", "bundle_hysteresis", "plectoneme")


def main(args) -> None:
    sys.path.insert(0, str(Path(__file__).parent))
    print(machine_line(args.device), f"; newton {newton.__version__}", sep="")
    others = {Vbd: tuple(SCENES)}
    if importlib.util.find_spec("dismech_newton"):
        others[importlib.import_module("dismech_scene").Dismech] = CHAINS
    names = ("SolverVBD", "dismech-newton")[: len(others)]
    print("", "example", "what is off", "SolverDER", *names, sep=" | ", end=" |\n")
    print("| --- " * (3 + len(others)), end="|\n")
    for name in args.examples or WHAT:
        module = importlib.import_module(name)
        example = module.Example(ViewerNull(num_frames=1), args)
        took = run(module.Example.frame_count, lambda k, e=example: e.step(), args.device)
        error = der_error(name, example, module, args)
        print(f"| {name} | {WHAT[name]} | {error:.2g}, {took:.1f} ms |", end="", flush=True)
        for solver, stated in others.items():
            said = " - |"
            if name in stated:
                error, took = SCENES[name](solver, module, args)
                said = f" {error:.2g}, {took:.1f} ms |"
            print(said, end="", flush=True)
        print()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("examples", nargs="*", metavar="EXAMPLE", help=", ".join(WHAT))
    parser.add_argument("--iterations", type=int, default=20, help="of the others")
    parser.add_argument("--device", default="cpu", help="cpu, cuda:0")
    warnings.simplefilter("ignore")  # Newton corrects the inertia of thin capsules
    main(parser.parse_args())
