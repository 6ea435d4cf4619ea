"""A hand flicks a hanging cable so that its tip hits a mark: the motion is found by gradients.

Steps of `SolverDER` on a `wp.Tape` give the gradient of where the tip is in the end by everything
that the hand does before, at a few times the cost of the steps, however many numbers say what that
is. Here they are the knots of a spline, and SciPy's L-BFGS-B looks for those that bring the tip to
the mark while the hand stays near its place.

Success criteria:
- The tip is within 1 mm of the mark, which is 0.4 m from where it hung; the hand was never further
  than 0.12 m from its place.
- The gradient agrees with differences within 1e-4: those of poses in single precision.

Run: `python examples/newton/flick_cable.py` (`--viewer null --test` without a display)
"""

import newton
import newton.examples
import numpy as np
import warp as wp
from scipy.interpolate import BSpline
from scipy.optimize import minimize

import wrod

LENGTH, EDGES, KNOTS = 0.4, 16, 7
HAND = np.array([0.0, 0.0, 0.6])
MARK = np.array([0.25, 0.15, 0.48])
EFFORT = 2e-3  # of the hand's mean square way, over that of the tip to the mark


@wp.kernel
def move_hand(
    knot: wp.array(dtype=wp.vec3d),
    weight: wp.array2d(dtype=wp.float64),
    start: wp.vec3d,
    frame: int,
    hand: int,
    poses: wp.array(dtype=wp.transform),
):
    p = wp.vec3d(start)
    for k in range(knot.shape[0]):
        p += weight[frame, k] * knot[k]
    poses[hand] = wp.transform(wp.vec3(float(p[0]), float(p[1]), float(p[2])), wp.quat_identity())


@wp.kernel
def measure(
    q: wp.array(dtype=wp.vec3d), tip: int, mark: wp.vec3d, loss: wp.array(dtype=wp.float64)
):
    loss[0] = wp.length_sq(q[tip] - mark)


class Example:
    frame_dt = 1.0 / 60.0
    frame_count = 54

    def __init__(self, viewer, args):
        self.viewer, self.frame = viewer, 0
        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        cfg = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False)
        self.hand = builder.add_link(xform=wp.transform(wp.vec3(*HAND)), is_kinematic=True)
        mark = builder.add_link(xform=wp.transform(wp.vec3(*MARK)), is_kinematic=True)
        for body, radius in ((self.hand, 0.02), (mark, 0.012)):
            builder.add_shape_sphere(body, radius=radius, cfg=cfg)
        points = HAND - np.linspace(0.0, LENGTH, EDGES + 1)[:, None] * [0.0, 0.0, 1.0]
        material = wrod.RodMaterial.from_youngs_modulus(1e7, 0.004, LENGTH, density=1150.0)
        wrod.SolverDER.add_rod(
            builder, points, material, start="clamped", start_body=self.hand,
            internal_damping=0.01, air_damping=0.3,
        )  # fmt: skip
        self.model = builder.finalize(device=args.device, requires_grad=True)
        self.solver = wrod.SolverDER(self.model, tolerance=1e-9)
        # How far each knot moves the hand in a frame; the first three are at rest.
        times = np.arange(1, self.frame_count + 1) / self.frame_count
        places = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, KNOTS + 1), np.ones(3)])
        weight = BSpline.design_matrix(times, places, 3).toarray()[:, 3:]
        self.weight = wp.array(weight, dtype=wp.float64, device=args.device)
        self.knot = wp.zeros(KNOTS, dtype=wp.vec3d, device=args.device, requires_grad=True)
        self.loss = wp.zeros(1, dtype=wp.float64, device=args.device, requires_grad=True)
        self.off: list[float] = []
        self.state = self.model.state()
        self.viewer.set_model(self.model)
        self.find()

    def place(self, state, frame: int) -> None:
        inputs = [self.knot, self.weight, wp.vec3d(*HAND), frame, self.hand]
        wp.launch(move_hand, 1, inputs, [state.body_q], device=self.model.device)

    def evaluate(self, knots: np.ndarray) -> tuple[float, np.ndarray]:
        """Loss of a motion (3 KNOTS,), and its gradient."""
        self.knot.assign(knots.reshape(-1, 3))
        state, other, tape = self.model.state(), self.model.state(), wp.Tape()
        with tape:
            for frame in range(self.frame_count):
                self.place(state, frame)
                self.solver.step(state, other, None, None, self.frame_dt)
                state, other = other, state
            inputs = [state.der.node_q, EDGES, wp.vec3d(*MARK)]
            wp.launch(measure, 1, inputs, [self.loss], device=self.model.device)
        tape.backward(self.loss)
        found, gradient = float(self.loss.numpy()[0]), self.knot.grad.numpy().ravel().copy()
        tape.zero()
        self.off.append(found**0.5)
        return found + EFFORT * np.mean(knots**2), gradient + 2.0 * EFFORT / knots.size * knots

    def find(self) -> None:
        """Look for the motion."""
        knots = np.full(3 * KNOTS, 1e-3)
        rng = np.random.default_rng(0)
        way = rng.normal(size=knots.shape)
        up, down = (self.evaluate(knots + s * 3e-4 * way)[0] for s in (1.0, -1.0))
        gradient = self.evaluate(knots)[1] @ way
        self.wrong = abs((up - down) / 6e-4 / gradient - 1.0)
        self.off.clear()
        found = minimize(self.evaluate, knots, jac=True, method="L-BFGS-B",
                         options={"maxfun": 60, "ftol": 1e-12})  # fmt: skip
        self.knot.assign(found.x.reshape(-1, 3))
        off, count = 1e3 * np.array(self.off), len(self.off)
        print(
            f"off by {off[0]:.0f} mm at first, by less than 1 mm after {np.argmax(off < 1.0) + 1} "
            f"motions, by {off[-1]:.2f} mm after {count}; gradient off by {self.wrong:.1e}"
        )

    def step(self) -> None:
        if self.frame < self.frame_count:
            self.place(self.state, self.frame)
            self.solver.step(self.state, self.state, None, None, self.frame_dt)
            self.frame += 1

    def render(self) -> None:
        self.viewer.begin_frame(self.frame * self.frame_dt)
        self.viewer.log_state(self.state)
        self.viewer.end_frame()

    def test_final(self) -> None:
        off = np.linalg.norm(self.state.der.node_q.numpy()[EDGES] - MARK)
        if off > 1e-3:
            raise ValueError(f"the tip is {off} m from the mark")
        way = np.linalg.norm(self.weight.numpy() @ self.knot.numpy(), axis=1).max()
        if way > 0.12:
            raise ValueError(f"the hand went {way} m from its place")
        if self.wrong > 1e-4:
            raise ValueError(f"the gradient is off by {self.wrong}")


if __name__ == "__main__":
    parser = newton.examples.create_parser()
    parser.set_defaults(num_frames=Example.frame_count)
    viewer, args = newton.examples.init(parser)
    newton.examples.run(Example(viewer, args), args)
