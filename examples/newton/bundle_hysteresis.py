"""A bundle of seven cables keeps the bend that pegs gave it; an elastic cable does not.

The strands of the cables rub (Dahl's law): bent and let go, they come back part of the way. Four
pegs press an S into the bundle and leave it again; above lies a cable of the same stiffness without
friction. There is no gravity.

Success criteria:
- The bundle keeps 20 to 80 % of the S's height; the elastic cable is straight to 3 % of it.
- Cables sink into each other by at most 5 % of their radius.
- At the end all are at rest.

Run: `python examples/newton/bundle_hysteresis.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod
from wrod.rods.law import Dahl

LENGTH, EDGES, RADIUS = 0.6, 16, 0.004
PEG, AWAY, PRESS = 0.01, 0.06, 0.012  # radius of pegs; where they wait and go to from the axis [m]
PRESSING, HOLDING, LEAVING, RESTING = 1.0, 0.3, 0.5, 2.2  # [s]


def smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = round((PRESSING + HOLDING + LEAVING + RESTING) / frame_dt)

    def __init__(self, viewer, args):
        self.viewer, self.sim_time, self.deepest, self.pressed = viewer, 0.0, 0.0, 0.0
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        wrod.SolverDER.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = 0.0
        section = dict(
            length=LENGTH, bending_stiffness=0.01, twisting_stiffness=0.007,
            stretching_stiffness=2e3, line_mass=0.055, radius=RADIUS,
        )  # fmt: skip
        stranded = wrod.RodModel(**section, law=Dahl(slip_curvature=2.0, kept_stiffness=0.3))
        x = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, EDGES + 1)
        places = [(0.0, 0.0)]
        around = np.pi / 3.0 * np.arange(6)
        places += list(2.1 * RADIUS * np.column_stack([np.cos(around), np.sin(around)]))
        places.append((0.0, 0.04))
        for k, (y, z) in enumerate(places):
            last = k == len(places) - 1
            wrod.SolverDER.add_rod(
                builder, np.column_stack([x, y + 0 * x, z + 0 * x]),
                wrod.RodModel(**section) if last else stranded, touches_rods=not last,
                air_damping=3.0, internal_damping=0.02, color=(0.8, 0.5, 0.1) if last else None,
            )  # fmt: skip
        self.pegs = []
        self.sides = np.array([1.0, -1.0, 1.0, -1.0])
        for place, side in zip(np.linspace(-0.2, 0.2, 4), self.sides, strict=True):
            peg = builder.add_link(
                xform=wp.transform((place, side * AWAY, 0.02)), is_kinematic=True
            )
            builder.add_shape_capsule(peg, radius=PEG, half_height=0.06)
            self.pegs.append(peg)
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model, rod_contact=0.3)
        self.state = self.model.state()
        self.viewer.set_model(self.model)

    def heights(self) -> np.ndarray:
        """(cable,) half the way from the farthest left to the farthest right of a straight line
        through the cable [m]."""
        q = self.state.der.node_q.numpy().reshape(-1, EDGES + 1, 3)
        off = [y - np.polyval(np.polyfit(x, y, 1), x) for x, y, _ in q.transpose(0, 2, 1)]
        return 0.5 * np.ptp(off, axis=1)

    def step(self) -> None:
        self.sim_time += self.frame_dt
        way = smooth(self.sim_time / PRESSING)
        way -= smooth((self.sim_time - PRESSING - HOLDING) / LEAVING)
        poses = self.state.body_q.numpy()
        poses[self.pegs, 1] = self.sides * (AWAY - (AWAY + PRESS) * way)
        self.state.body_q.assign(poses)
        self.solver.step(self.state, self.state, None, None, self.frame_dt)
        self.deepest = max(self.deepest, float(self.solver.penetration().max()))
        self.pressed = max(self.pressed, float(self.heights()[-1]))

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("a cable diverged")
        kept = self.heights() / max(self.pressed, 1e-9)
        stays = kept[:-1].min() > 0.2 and kept[:-1].max() < 0.8
        if not (stays and self.pressed > 2.0 * RADIUS):
            raise ValueError(f"of {self.pressed} m the cables of the bundle keep {kept[:-1]}")
        if kept[-1] > 0.03:
            raise ValueError(f"the elastic cable keeps {kept[-1]} of its bend")
        if self.deepest > 0.05 * RADIUS:
            raise ValueError(f"a cable was {self.deepest} m inside another")
        speed = np.abs(self.state.der.node_qd.numpy()).max()
        if speed > 5e-3:
            raise ValueError(f"a cable still moves at {speed} m/s")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
