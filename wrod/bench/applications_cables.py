"""What the cables of the applications meet: their scenes, the plan, and the disturbances."""

from dataclasses import replace

import numpy as np

from wrod.deployment.fixtures import Fixtures
from wrod.deployment.setup import DEVIATIONS, Disturbance
from wrod.patterns.pattern import Pattern
from wrod.rods.catalogue import rod
from wrod.rods.material import RodMaterial

# Distance p between gates: 0.56 L_gb. Between two gates only friction holds a bend of curvature
# kappa, which on a slippery table is little; were it to straighten, it would be kappa p^2 / 2 off.
PITCH = 0.045
# Standard deviation of how far the cable slips through the grip in a trial [m].
SLIP = 1e-3
# The plan is made for a cable stiffer than the nominal one by this many standard deviations: one
# that is stiffer than believed comes down beside its gates, a softer one still falls into them.
ALLOWANCE = 1.5
# Of the trials' random numbers. The scenes were designed with seeds 5000 to 6059.
_SEED = {"S cable": 41_000, "U cable": 42_000}


def believed(cable: RodMaterial) -> RodMaterial:
    """The cable that the plan is made for."""
    factor = 1.0 + ALLOWANCE * DEVIATIONS["lgb_error"]
    return replace(cable, gravito_bending_length=factor * cable.gravito_bending_length)


def plan_cable(pattern: Pattern, cable: RodMaterial, method: str):
    """OPT is `wrod.plan`'s default, which in bends asks for the least friction (min_friction), with
    the allowance for L_gb; INT goes by the pattern alone."""
    from wrod.deployment.plan import plan

    if method == "intuitive":
        return plan(pattern, cable, "intuitive")
    return plan(pattern, believed(cable), "auto")


def gates(pattern: Pattern) -> Fixtures:
    """The scene along a pattern, as shipped in scenes/cable."""
    from wrod.deployment.gates import design_gates

    scene = design_gates(pattern, believed(rod("cable")), pitch=PITCH)
    note = (
        "Pairs of posts by wrod.deployment.gates.design_gates for rod 'cable', OPT's plan: "
        "where the cable "
        f"comes down with the least sideways motion, {1e3 * PITCH:g} mm apart if possible, each "
        "post 3 standard deviations of the sideways error clear of the cable's middle, and on the "
        "side from which it comes as much farther as it still is to that side when it is as low "
        "as the posts."
    )
    return replace(scene, note=note)


def disturbance(case: str, trial: int) -> Disturbance:
    return Disturbance.random(_SEED[case] + trial, slip=SLIP)


_KNOTS = "knots also: place of each hand 1 mm in every direction, friction of its fingertips 30 %"


def disturbances_text(rows: list[dict]) -> str:
    """A table of what every trial was disturbed by, stated and as drawn in these rows."""
    drawn = [row["disturbance"] for row in rows if row.get("disturbance")]

    def rms(pick, scale: float) -> str:
        values = np.array([pick(d) for d in drawn], dtype=float)
        return "-" if not len(values) else f"{scale * np.sqrt(np.mean(values**2)):.2f}"

    one = DEVIATIONS
    entries = [
        ("L_gb against the nominal [%]", 100 * one["lgb_error"], lambda d: d["lgb_error"], 100),
        ("robot's place, x and y [mm]", 1e3 * one["placement"], lambda d: d["offset"], 1e3),
        ("robot's yaw [degrees]", np.degrees(one["yaw"]), lambda d: d["yaw"], np.degrees(1.0)),
        ("arm jitter, each axis [mm]", 1e3 * one["jitter"], lambda d: d["jitter"], 1e3),
        (
            "natural curvature [1/m]",
            one["natural_curvature"],
            lambda d: d["natural_curvature"],
            1.0,
        ),
        ("cables: slip in the grip [mm]", 1e3 * SLIP, lambda d: d["slip"], 1e3),
    ]
    lines = [
        "| disturbance | standard deviation | drawn for the cables, rms |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {name} | {size:g} | {rms(pick, scale)} |" for name, size, pick, scale in entries]
    return "\n".join(lines) + f"\n\n{_KNOTS}\n"


# How far beside a gate, and how high above it, the cable's way there is kept [m].
_NEAR, _LOW = 0.04, 0.03


def ways_to_gates(frames: np.ndarray, fixtures: Fixtures) -> list[list]:
    """How the cable comes to each gate: (y, z) of its middle in the gate's plane over time [mm], y
    from the middle of the gate to the left, z from where it lies on the table.

    Args:
        frames: (frame, node, 3) [m].
        fixtures: whose gates.
    """
    by_name = {item.name: np.array(item.shape.center[:2]) for item in fixtures.items}
    out = []
    for left, right in fixtures.gates:
        a, b = by_name[left], by_name[right]
        across = (a - b) / np.linalg.norm(a - b)
        flat = frames[:, :, :2] - (a + b) / 2
        y = flat @ across
        ahead = flat @ np.array([across[1], -across[0]])
        frame, node = np.nonzero((ahead[:, :-1] < 0) & (ahead[:, 1:] >= 0))
        part = ahead[frame, node] / (ahead[frame, node] - ahead[frame, node + 1])

        def there(values, frame=frame, node=node, part=part):
            first = values[frame, node]
            return first + part * (values[frame, node + 1] - first)

        side, height = there(y), there(frames[:, :, 2])
        near = (np.abs(side) < _NEAR) & (height < _LOW)
        way = 1e3 * np.column_stack([side, height])[near]
        out.append(np.round(way, 1).tolist())
    return out
