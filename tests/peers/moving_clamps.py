"""Recordings of rods between two moving clamps, by PyElastica's Cosserat rods."""

import numpy as np

# A thick and soft rod of the wanted weight and bending stiffness: sound is slow, so steps are long.
ELEMENTS, ELEMENT, RADIUS, DENSITY, GRAVITY = 26, 0.025, 0.015, 1000.0, 9.81
L_GB, DRAG, POISSON = 0.15, 4.0, 0.5
RATE, RAMP, SECONDS, STEP = 100.0, 0.6, 1.0, 2e-4
# Nodes that carry markers: two at each end are in a clamp.
MARKERS = np.array([0, *range(1, ELEMENTS, 3), ELEMENTS])


def smooth(time):
    """0 before the ramp, 1 after it, and still at both ends."""
    u = np.clip(time / RAMP, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def grip(side: float, seconds: float, rng) -> tuple[np.ndarray, np.ndarray]:
    """Path of one clamp, from straight to hanging, at every half step.

    Returns:
        (k, 3) places of its inner node, and (k, 3, 3) rows d1, d2, tangent of the rod there.
    """
    time = np.arange(round(2.0 * seconds / STEP) + 3) * 0.5 * STEP
    on, after = smooth(time), np.maximum(time - 0.5 * RAMP, 0.0)
    go = smooth(after)
    size, speed = rng.uniform(0.01, 0.05, (3, 2)), rng.uniform(3.0, 9.0, (3, 2))
    half = 0.5 * ELEMENT * (ELEMENTS - 2)
    inner = go[:, None] * (size * np.sin(speed * after[:, None, None])).sum(axis=2)
    inner[:, 0] += side * (half + on * (0.17 - half))
    size, speed = rng.uniform(0.1, 0.3, (2, 1)), rng.uniform(3.0, 8.0, (2, 1))
    lean, turn = go * size * np.sin(speed * after)
    pitch = side * (1.1 * on + lean)
    c, s, o = np.cos(pitch), np.sin(pitch), np.zeros_like(time)
    rows = np.stack([o, o - 1.0, o, s, o, -c, c, o, s], axis=1).reshape(-1, 3, 3)
    c, s = np.cos(turn), np.sin(turn)
    about_z = np.stack([c, s, o, -s, c, o, o, o, o + 1.0], axis=1).reshape(-1, 3, 3)
    return inner, rows @ about_z


def recordings(hide, seeds, seconds=SECONDS) -> dict[str, np.ndarray]:
    """A motion set of one rod, in the format of `wrod.identification.load_motion`.

    Args:
        hide: called with every PyElastica rod, to give it what is to be found.
        seeds: one for each recording.
    """
    shapes = run(hide, [np.random.default_rng(seed) for seed in seeds], RAMP + seconds)
    count = len(MARKERS)
    return {
        "positions": shapes,
        "rate_hz": np.float64(RATE),
        "held": np.array([0, 1, count - 2, count - 1]),
        "gravity": np.float64(GRAVITY),
    }


def run(hide, generators, seconds) -> np.ndarray:
    """(rod, frame, marker, 3) from the end of the ramp on, with 0.02 mm of noise."""
    import elastica

    class Simulator(
        elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
    ):
        pass

    class Moved(elastica.ConstraintBase):
        """Two nodes and the element between them on a path given at every half step."""

        def __init__(self, path, inner, outer, element, sign, **keys):
            super().__init__(**keys)
            (self.place, self.frame), self.at = path, (inner, outer, element)
            self.arm = sign * ELEMENT * self.frame[:, 2]
            self.speed, self.swing, turn = (
                np.gradient(a, 0.5 * STEP, axis=0) for a in (self.place, self.arm, self.frame)
            )
            # dQ/dt = -[omega]_x Q, omega in the frame's own components.
            spin = turn @ self.frame.transpose(0, 2, 1)
            self.omega = np.stack([spin[:, 1, 2], spin[:, 2, 0], spin[:, 0, 1]], axis=1)

        def constrain_values(self, system, time):
            (inner, outer, element), k = self.at, round(2.0 * time / STEP)
            system.position_collection[:, inner] = self.place[k]
            system.position_collection[:, outer] = self.place[k] + self.arm[k]
            system.director_collection[:, :, element] = self.frame[k]

        def constrain_rates(self, system, time):
            (inner, outer, element), k = self.at, round(2.0 * time / STEP)
            system.velocity_collection[:, inner] = self.speed[k]
            system.velocity_collection[:, outer] = self.speed[k] + self.swing[k]
            system.omega_collection[:, element] = self.omega[k]

    youngs = 8.0 * DENSITY * GRAVITY * L_GB**3 / RADIUS**2
    length, last = ELEMENTS * ELEMENT, ELEMENTS
    simulator, rods = Simulator(), []
    for rng in generators:
        rod = elastica.CosseratRod.straight_rod(
            ELEMENTS, np.array([-0.5 * length, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]),
            np.array([0.0, -1.0, 0.0]), length, RADIUS, DENSITY,
            youngs_modulus=youngs, shear_modulus=youngs / (2.0 * (1.0 + POISSON)),
        )  # fmt: skip
        # Half of the first and last Voronoi length is inside a clamp, where nothing bends.
        rod.bend_matrix[:, :, [0, -1]] *= 2.0
        hide(rod)
        simulator.append(rod)
        for side, ends in ((-1.0, (1, 0, 0)), (1.0, (last - 1, last, last - 1))):
            path = grip(side, seconds, rng)
            simulator.constrain(rod).using(Moved, path, *ends, side)
        simulator.add_forcing_to(rod).using(
            elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY])
        )
        simulator.dampen(rod).using(
            elastica.AnalyticalLinearDamper, uniform_damping_constant=DRAG, time_step=STEP
        )
        rods.append(rod)
    simulator.finalize()
    stepper, time, out = elastica.PositionVerlet(), np.float64(0.0), []
    every = round(1.0 / (RATE * STEP))
    for step in range(round(seconds / STEP)):
        if step % every == 0 and step * STEP >= RAMP:
            out.append([rod.position_collection[:, MARKERS].T.copy() for rod in rods])
        time = stepper.step(simulator, time, STEP)
    shape = np.stack(out, axis=1)
    noise = [rng.normal(0.0, 2e-5, s.shape) for rng, s in zip(generators, shape, strict=True)]
    return shape + np.stack(noise)
