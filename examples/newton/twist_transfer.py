"""Flexible shafts: what one end of a cable is turned by arrives at the other, around a bend.

Three straight cables of Young's modulus 2, 20 and 200 MPa are bent to half circles. A hand clamps
one end and turns it; the other runs in a bearing, which holds its place and direction, not roll. A
fourth cable is straight and clamped at both ends. There is no gravity.

Success criteria:
- Each bearing's end has turned as far as its hand (a round, naturally straight shaft turns evenly),
  and no torque is left in the hand.
- The shafts are still half circles, which need no force.
- The torque in the clamped cable is that of Saint-Venant, C phi / L, within 0.1 %.

Run: `python examples/newton/twist_transfer.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp

import wrod

YOUNGS, RADIUS, EDGES = (2e6, 2e7, 2e8), 0.004, 24
BEND = 0.15  # radius of the half circles [m]
TURN, CLAMPED_TURN = 10.0, 1.5  # of the hands [rad]
MOVING, RESTING = 4.0, 3.0  # [s]


def smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = round((MOVING + RESTING) / frame_dt)

    def __init__(self, viewer, args):
        self.viewer, self.sim_time = viewer, 0.0
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        wrod.SolverDER.register_custom_attributes(builder)
        self.hands, self.rods, self.materials, self.circles = [], [], [], []
        # Half circles along y at their first node and last edge, and a straight line. A hand clamps
        # the direction that the first edge has at first.
        turn = np.pi * (np.arange(EDGES) + 0.5) / (EDGES - 0.5)
        ways = np.column_stack([np.sin(turn), np.cos(turn), 0.0 * turn])
        edge = np.pi * BEND / EDGES
        half = np.concatenate([np.zeros((1, 3)), np.cumsum(edge * ways, axis=0)])
        straight = np.linspace(0.0, 1.0, EDGES + 1)[:, None] * [0.0, np.pi * BEND, 0.0]
        for k, young in enumerate([*YOUNGS, YOUNGS[1]]):
            points = (straight if k == len(YOUNGS) else half) + [0.45 * k, 0.0, 0.0]
            self.circles.append(points.copy())
            hand = builder.add_link(xform=wp.transform(wp.vec3(*points[0])), is_kinematic=True)
            material = wrod.RodMaterial.from_youngs_modulus(young, RADIUS, np.pi * BEND)
            rod = wrod.SolverDER.add_rod(
                builder, points, material, start="clamped", start_body=hand, director=(0, 0, 1),
                end="clamped" if k == len(YOUNGS) else "free", air_damping=2.0,
                internal_damping=0.02, rest_length=edge, color=(0.3 * k, 0.4, 0.6),
            )  # fmt: skip
            if k < len(YOUNGS):
                for node in (EDGES - 1, EDGES):
                    wrod.SolverDER.attach(builder, rod, -1, node=node, kind="pinned")
            self.hands.append(hand)
            self.rods.append(rod)
            self.materials.append(material)
        self.model = builder.finalize(device=args.device)
        self.solver = wrod.SolverDER(self.model)
        self.state = self.model.state()
        self.viewer.set_model(self.model)

    def angle(self, k: int, edge: int) -> float:
        """Angle of an edge about its tangent, from the vertical [rad]."""
        first = self.model.der.rod_first_node.numpy()[self.rods[k]]
        along = np.diff(self.state.der.node_q.numpy()[first + edge : first + edge + 2], axis=0)[0]
        at = self.model.der.rod_first_edge.numpy()[self.rods[k]] + edge
        director = self.state.der.edge_director.numpy()[at]
        side = np.cross(along / np.linalg.norm(along), [0.0, 0.0, 1.0])
        return float(np.arctan2(director @ side, director[2]))

    def step(self) -> None:
        self.sim_time += self.frame_dt
        way = smooth(self.sim_time / MOVING)
        poses = self.state.body_q.numpy()
        for k, hand in enumerate(self.hands):
            half = 0.5 * way * (CLAMPED_TURN if k == len(YOUNGS) else TURN)
            poses[hand, 3:] = [0.0, np.sin(half), 0.0, np.cos(half)]
        self.state.body_q.assign(poses)
        self.solver.step(self.state, self.state, None, None, self.frame_dt)

    def render(self) -> None:
        self.viewer.begin_frame(self.sim_time)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        if self.solver.diverged.any():
            raise ValueError("a cable diverged")
        q = self.state.der.node_q.numpy()
        torques = self.solver.body_wrenches()[self.hands, 4]
        for k, material in enumerate(self.materials[:-1]):
            given, come = self.angle(k, 0), self.angle(k, EDGES - 1)
            off = (come - given + np.pi) % (2 * np.pi) - np.pi
            if abs(off) > 1e-3 or abs((given - TURN + np.pi) % (2 * np.pi) - np.pi) > 1e-3:
                raise ValueError(f"shaft {k}: {given} rad went in, {come} rad came out")
            moment = material.bending_stiffness / BEND
            if abs(torques[k]) > 1e-3 * moment:
                raise ValueError(f"shaft {k}: {torques[k]} N m are left in the hand")
        strayed = np.abs(q - np.concatenate(self.circles)).max()
        if strayed > 2e-3 * BEND:
            raise ValueError(f"a shaft has strayed by {strayed} m")
        material = self.materials[-1]
        expected = -material.twisting_stiffness * CLAMPED_TURN / (np.pi * BEND)
        if abs(torques[-1] / expected - 1.0) > 1e-3:
            raise ValueError(f"the clamped cable holds {torques[-1]} N m, not {expected}")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
