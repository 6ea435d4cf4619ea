"""wrod as a solver of `cosseratbench`, from public names only (entry point "wrod")."""

import numpy as np
from cosseratbench import Capability, Trajectory
from cosseratbench.scenario import Cylinder, End, EndCondition, Rod, Scenario
from cosseratbench.solver import Diverged

import wrod

# Largest step [s]: of what moves, and of what comes to rest.
_STEP, _QUIET_STEP = 2e-3, 5e-3
# Largest unbalanced force over the weight, of the same; a swing of 2 cm is a fiftieth of it.
_TOLERANCE, _QUIET_TOLERANCE = 1e-7, 1e-6
# Of a shape, a fraction of the radius under the rod's weight.
_SINKING = 1.0 / 200.0


class Adapter:
    """A solver of discrete elastic rods that may touch.

    Args:
        time_step_scale: factor of the time step.
    """

    capabilities = frozenset(
        {
            Capability.STRETCH,
            Capability.ROD_CONTACT,
            Capability.ROD_FRICTION,
            Capability.CYLINDER_CONTACT,
            Capability.PLANE_CONTACT,
        }
    )

    def __init__(self, time_step_scale: float = 1.0):
        self.time_step_scale = time_step_scale

    def play(self, scene, scenario: Scenario, n_frames: int, steps: int) -> Trajectory:
        """So many steps a frame of a scene that can `advance` and `read` its rods; raises
        `cosseratbench.solver.Diverged`."""
        times = np.linspace(0.0, scenario.duration, n_frames)
        found = [scene.read()]
        for time in times[1:]:
            scene.advance(steps)
            found.append(scene.read())
            if not all(np.isfinite(part).all() for part in found[-1][0]):
                raise Diverged(f"a {scene.piece} is nowhere", time=float(time))
        positions, directors = (
            tuple(np.array(rod) for rod in zip(*part, strict=True))
            for part in zip(*found, strict=True)
        )
        return Trajectory(times, positions, directors)


class WrodSolver(Adapter):
    """Implicit steps, contact at true thickness with Coulomb friction."""

    name = "wrod"
    backend_version = wrod.__version__

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict:
        """The numerical choices of a run."""
        interval = scenario.duration / (n_frames - 1)
        largest = _QUIET_STEP if scenario.quasi_static else _STEP
        return {
            "integrator": "bdf2 (implicit)" if scenario.quasi_static else "midpoint (implicit)",
            "time_step": interval / np.ceil(interval / (largest * self.time_step_scale)),
            "tolerance": _QUIET_TOLERANCE if scenario.quasi_static else _TOLERANCE,
            "damping_rate": 2.0 * scenario.slowest_frequency() if scenario.quasi_static else 0.0,
        }

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Raises `cosseratbench.solver.Diverged`."""
        options = self.settings(scenario, n_elements=n_elements, n_frames=n_frames)
        batch, rods = wrod.join_rods([_rod(scenario, spec, n_elements) for spec in scenario.rods])
        motion = _held(batch, scenario, rods)
        dynamics = wrod.Dynamics(
            batch,
            scheme=options["integrator"].split()[0],
            inertia="consistent",
            tolerance=options["tolerance"],
            radius=_radius(scenario, rods)[None, :-1],
            air_damping=options["damping_rate"],
            contact=_contacts(batch, scenario, rods),
            motion=motion,
            keeps_recording=True,
        )
        inside = []
        for nodes, spec in zip(rods, scenario.rods, strict=True):
            before, after = ghosts_of(spec)
            inside.append(slice(nodes.start + before, nodes.stop - after))
        times = np.linspace(0.0, scenario.duration, n_frames)
        positions, directors = [], []
        for time in times:
            if dynamics.advance(time, options["time_step"]).diverged.any():
                raise Diverged("no step converged", time=float(dynamics.time.numpy()[0]))
            positions.append(batch.positions()[0].copy())
            directors.append(batch.material_directors()[0, :, 0].copy())
        positions, directors = np.array(positions), np.array(directors)
        return Trajectory(
            times,
            tuple(positions[:, nodes] for nodes in inside),
            tuple(directors[:, nodes.start : nodes.stop - 1] for nodes in inside),
        )


def ghosts_of(spec: Rod) -> tuple[bool, bool]:
    """Whether start and end are clamped, and have an edge beyond them that the clamp turns."""
    clamped = EndCondition.CLAMPED
    return spec.condition(End.START) is clamped, spec.condition(End.END) is clamped


def with_ghosts(spec: Rod, n_elements: int) -> tuple[np.ndarray, np.ndarray]:
    """(node, 3) nodes and (edge, 3) directors where a rod begins, its ghosts' among them."""
    position, (before, after) = spec.nodes(n_elements), ghosts_of(spec)
    for there, where, at, inner in ((after, n_elements + 1, -1, -2), (before, 0, 0, 1)):
        if there:
            way = position[at] - position[inner]
            beyond = position[at] + spec.length / n_elements * way / np.linalg.norm(way)
            position = np.insert(position, where, beyond, axis=0)
    director = np.pad(spec.directors(n_elements), ((before, after), (0, 0)), mode="edge")
    return position, director


def _rod(scenario: Scenario, spec: Rod, n_elements: int) -> wrod.RodBatch:
    """One rod of the scenario; a clamped end has the edge beyond it that the clamp turns."""
    m, area, second = spec.material, spec.area, spec.second_moment_of_area
    gravity = np.asarray(scenario.gravity, dtype=float)
    size = float(np.linalg.norm(gravity))
    of = wrod.Profile.of
    model = wrod.RodModel(
        length=spec.length,
        bending_stiffness=(of(m.youngs_modulus * second),) * 2,
        twisting_stiffness=of(2.0 * m.shear_modulus * second),
        stretching_stiffness=of(m.youngs_modulus * area),
        line_mass=of(m.density * area),
        radius=spec.radius,
        gravity=size or 9.81,
    )
    arc, load = np.linspace(0.0, spec.length, n_elements + 1), np.zeros((n_elements + 1, 3))
    for force in spec.loads:
        load[0 if force.at is End.START else -1] += force.force
    ghosts = ghosts_of(spec)
    arc = np.concatenate([[-arc[1]] * ghosts[0], arc, [arc[-1] + arc[1]] * ghosts[1]])
    position, director = with_ghosts(spec, n_elements)
    batch = wrod.RodBatch.of(
        model, arc, position[None], clamped=ghosts, director=director[None], gravity=gravity,
        point_load=np.pad(load, (ghosts, (0, 0)))[None],
    )  # fmt: skip
    ends = ((0, End.START), (-1, End.END))
    wrod.prescribe(
        batch, pinned_nodes=[k for k, end in ends if spec.condition(end) is EndCondition.PINNED]
    )
    return batch


def _held(batch: wrod.RodBatch, scenario: Scenario, rods) -> wrod.PrescribedMotion | None:
    """Every clamp, along its timetable if it has one."""
    clamps = [
        (spec, nodes, end)
        for spec, nodes in zip(scenario.rods, rods, strict=True)
        for end in End
        if spec.condition(end) is EndCondition.CLAMPED
    ]
    if not clamps:
        return None
    motions = [spec.motion(end) for spec, _, end in clamps]
    times = sorted(
        {0.0, scenario.duration, *(t for m in motions if m is not None for t in m.times)}
    )
    m1, m2 = np.moveaxis(batch.material_directors()[0], 1, 0)
    frames = np.stack([np.cross(m1, m2), m1, m2], axis=2)
    edge, part, slides, position, rotation = [], [], [], [], []
    for (_, nodes, end), motion in zip(clamps, motions, strict=True):
        at_start = end is End.START
        edge.append(nodes.start if at_start else nodes.stop - 2)
        part.append(1.0 if at_start else 0.0)
        here = batch.positions()[0, nodes.start + 1 if at_start else nodes.stop - 2]
        poses = [(np.zeros(3), np.eye(3)) if motion is None else motion.pose(t) for t in times]
        position.append([here + moved for moved, _ in poses])
        rotation.append([turned @ frames[edge[-1]] for _, turned in poses])
        slides.append("" if motion is None or motion.slides_along is None else _axis(motion.axis))
    return wrod.PrescribedMotion(
        batch, edge, times, np.array(position), np.array(rotation), part=part, slides=slides
    )


def _radius(scenario: Scenario, rods) -> np.ndarray:
    """(node,) radius of the rod that each node belongs to."""
    pairs = zip(scenario.rods, rods, strict=True)
    return np.concatenate([np.full(nodes.stop - nodes.start, spec.radius) for spec, nodes in pairs])


def _axis(axis: np.ndarray) -> str:
    (along,) = np.flatnonzero(np.abs(axis) > 1e-9)
    return "xyz"[along]


def _contacts(
    batch: wrod.RodBatch, scenario: Scenario, rods
) -> list[wrod.Contact | wrod.RodContact]:
    """With obstacles, and of rods with themselves and each other where the scenario has it."""
    out: list[wrod.Contact | wrod.RodContact] = []
    specs = scenario.rods
    radius = _radius(scenario, rods)
    if scenario.obstacles:
        shapes = [
            wrod.Cylinder(o.center, o.radius, o.length / 2, o.axis)
            if isinstance(o, Cylinder)
            else wrod.Plane(o.point, o.normal)
            for o in scenario.obstacles
        ]
        most = max(spec.friction for spec in specs)
        friction = [wrod.Friction(max(o.friction, most)) for o in scenario.obstacles]
        weight = max(s.material.density * s.area for s in specs) * np.linalg.norm(scenario.gravity)
        stiffness = weight / (_SINKING * radius)
        out.append(wrod.Contact(batch, radius[None], stiffness[None], [friction], [shapes]))
    if len(specs) > 1 or scenario.self_contact:
        rough = max(spec.friction for spec in specs)
        # Without friction nothing but corners would hold what slides.
        smooth = rough == 0.0 and not scenario.self_contact
        out.append(wrod.RodContact(batch, radius[None, :-1], wrod.Friction(rough), smooth=smooth))
    return out
