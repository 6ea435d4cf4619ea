"""What the files of arrays that wrod reads hold: a table each, from which docs/formats.md is
printed and against which `wrod.files.read_fields` checks.

Letters in a shape are lengths; the same letter is the same length within a file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

_INF = float("inf")
# A table, and everything on it or beside it, lies within so much [m].
FARTHEST = 100.0


@dataclass(frozen=True)
class Field:
    """An array of a file.

    Attributes:
        shape: lengths, as numbers, letters or "2 or 3"; a first letter that ends with "?" may be
            left out, and is 1 then.
        unit: of its values, "" for none.
        low, high: smallest and largest value.
        above: a value that all must exceed, instead of `low`.
        needed: whether a file without it is refused.
        kind: "numbers", "whole numbers", "truths", "text", "names" (text or whole numbers) or
            "rotations" (matrices, to `precision`).
        gaps: NaN stands where a value is not known.
        order: "rising" or "not falling", along the first axis.
        precision: of rotation matrices.
        about: what it is, where the name does not say it.
    """

    shape: tuple[int | str, ...] = ()
    unit: str = ""
    low: float = -_INF
    high: float = _INF
    above: float | None = None
    needed: bool = True
    kind: str = "numbers"
    gaps: bool = False
    order: str = ""
    precision: float = 1e-3
    about: str = ""


@dataclass(frozen=True)
class ArrayFile:
    """A kind of file.

    Attributes:
        about: what it is.
        what: what to give, for messages.
        fields: its arrays by name. In a name and in letters, {k} counts layers from 0.
        format: what the array `format` must say; "" where there is none.
        least: smallest length by letter.
        axes: what is counted, by letter, for messages.
        together: groups of arrays of which a file has all or none.
        suffix: of such files.
    """

    about: str
    what: str
    fields: Mapping[str, Field]
    format: str = ""
    least: Mapping[str, int] = field(default_factory=dict)
    axes: Mapping[str, str] = field(default_factory=dict)
    together: tuple[tuple[str, ...], ...] = ()
    suffix: str = ".npz"


def _place(*shape: int | str, **more) -> Field:
    return Field(shape, "m", -FARTHEST, FARTHEST, **more)


def _indices(*shape: int | str, **more) -> Field:
    return Field(shape, low=0, kind="whole numbers", **more)


def _optional(*shape: int | str, unit: str = "", **more) -> Field:
    return Field(shape, unit, needed=False, **more)


_GRAVITY = Field((), "m/s^2", above=0.0, high=30.0)
_LENGTH = Field((), "m", above=0.0, high=30.0)
_AXES = "columns m1, m2, tangent"
_CABLE = {
    "length": _LENGTH,
    "cable_mass": Field((), "kg", above=0.0, high=1e3),
    "tip_mass": Field((), "kg", 0.0, 1e3),
    "diameter": Field((), "m", above=0.0, high=1.0),
    "gravity": _GRAVITY,
}
_ANGLE = Field(("K",), "rad", -100.0, 100.0, about="of the hand")
_NETWORK = {
    "weight.{k}": Field(("H{k+1}", "H{k}")),
    "bias.{k}": Field(("H{k+1}",)),
}

ARRAYS = {
    "Trajectory": ArrayFile(
        "A trajectory that `wrod plan` wrote (`--trajectory`).",
        "the .npz of a trajectory that `wrod plan` wrote",
        {
            "metadata": Field(kind="text", needed=False, about="JSON of TrajectoryMetadata"),
            "arc_length": Field(("T",), "m", -1e-9, FARTHEST, order="rising", about="laid length"),
            "contact": _place("T", 3),
            "position": _place("T", 3),
            "rotation": Field(
                ("T", 3, 3),
                kind="rotations",
                precision=1e-6,
                about="first column the rod's tangent",
            ),
            "force": Field(("T", 3), "N", -1e12, 1e12, gaps=True),
            "shape": _place("T", "N", 3, needed=False, gaps=True),
            "twist": Field(("T",), "rad", -1e3, 1e3, needed=False),
            "roll": Field((), "rad", -1e6, 1e6, needed=False),
            "beyond_grip": Field(
                (), "m", 0.0, 1e6, needed=False, about="rod that hangs beyond the grip"
            ),
        },
        format="wrod-trajectory-1",
        least={"T": 2},
        axes={"T": "contact node"},
    ),
    "Deployment": ArrayFile(
        "A deployment that `wrod deploy` wrote; of one that diverged, values may be unknown.",
        "the .npz of a deployment that `wrod deploy` wrote",
        {
            "arc_length": Field(("N",), "m", -1e-9, 1e3, order="rising"),
            "centerline": Field(("N", 3), "m", gaps=True),
            "error_mean": Field((), "m", 0.0, gaps=True),
            "error_std": Field((), "m", 0.0, gaps=True),
            "released_centerline": Field(("N", 3), "m", gaps=True),
            "released_error_mean": Field((), "m", 0.0, gaps=True),
            "released_error_std": Field((), "m", 0.0, gaps=True),
            "contact_force": Field(("N", 3), "N", gaps=True),
            "slip": Field(("N",), "m", gaps=True),
            "diverged": Field(kind="truths"),
            "duration": Field((), "s", 0.0),
            "steps": _indices(),
            "frames": _optional("F", "N", 3, unit="m", gaps=True),
            "hand": _optional("F", 4, 4, gaps=True),
            "let_go": _optional(unit="s", gaps=True),
            "released_speed": _optional(unit="m/s", gaps=True),
            "penetration": _optional(unit="m", gaps=True),
        },
        format="wrod-deployment-1",
        least={"N": 2},
        axes={"N": "node", "F": "frame"},
    ),
    "JointPath": ArrayFile(
        "A joint path that `wrod plan` wrote.",
        "the .npz of a joint path that `wrod plan` wrote",
        {
            "metadata": Field(kind="text", about="a JSON object"),
            "names": Field(("J",), kind="text"),
            "time": Field(("K",), "s", 0.0, order="rising"),
            "positions": Field(("K", "J"), "rad", -1e3, 1e3),
            "velocities": Field(("K", "J"), "rad/s", -1e3, 1e3),
            "arc_length": Field(("K",), "m", -FARTHEST, FARTHEST),
            "node_time": Field(("T",), "s", 0.0, order="not falling"),
            "node_positions": Field(("T", "J"), "rad", -1e3, 1e3),
            "placement": Field((4,), "", -1e3, 1e3, about="x, y, z [m] and yaw [rad]"),
            "grip": Field((2,), "rad", -1e3, 1e3, about="angle and roll"),
        },
        format="wrod-joint-path-1",
        least={"K": 2, "J": 1, "T": 1},
        axes={"K": "sample", "J": "joint", "T": "contact node"},
    ),
    "ClampedMeasurements": ArrayFile(
        "A rod held between two clamps (`wrod identify`), z up. A clamp's axes are m1, m2 and the "
        "tangent towards the gripper.",
        "an .npz file of measurements (`wrod identify --template clamped` writes an example)",
        {
            "centerline": Field(("T", "M", 3), "m", gaps=True, about="markers, as seen"),
            "arc_length": Field(("M",), "m", about="of the markers from the clamp, unstretched"),
            "clamp_position": Field(("T", 3), "m"),
            "clamp_rotation": Field(("T", 3, 3), kind="rotations", about=_AXES),
            "grip_position": Field(("T", 3), "m"),
            "grip_rotation": Field(("T", 3, 3), kind="rotations", about=_AXES),
            "grip_force": _optional("T", 3, unit="N", about="of the gripper on the rod"),
            "grip_torque": _optional("T", 3, unit="N m", about="the same, about `grip_position`"),
            "train_idx": _indices("A", about="trials to fit to"),
            "test_idx": _indices("B", about="trials to score on"),
            "length": replace(_LENGTH, about="of the rod between clamp and gripper"),
            "radius": Field((), "m", above=0.0, high=1.0),
            "density": Field((), "kg/m^3", 1e-2, 1e5),
            "L_gb": replace(_LENGTH, about="as measured (`wrod loop`)"),
            "poisson": Field((), "", above=-1.0, high=0.5),
            "gravity": _GRAVITY,
            "noise_std": Field((), "m", above=0.0, about="of one coordinate of a marker"),
        },
        least={"T": 2, "M": 3, "A": 2, "B": 1},
        axes={"T": "trial", "M": "marker", "A": "trial", "B": "trial"},
        together=(("grip_force", "grip_torque"),),
    ),
    "MotionMeasurements": ArrayFile(
        "Recordings of a rod that two grips move (`wrod identify`).",
        "an .npz file of recordings (`wrod identify --template motion` writes an example)",
        {
            "positions": Field(("R", "F", "M", 3), "m", gaps=True, about="markers"),
            # Slower than any swing of a rod, and faster than any camera of markers.
            "rate_hz": Field((), "Hz", 2.0, 1e6),
            "held": _indices(4, about="markers inside the grips: the first and last two"),
            "gravity": _GRAVITY,
            "file_ids": _optional("R", kind="names"),
            "time": _optional("R", "F", unit="s", about="of frames, where some were lost"),
        },
        least={"R": 2, "F": 12, "M": 6},
        axes={"R": "recording", "F": "frame", "M": "marker"},
    ),
    "HangingLoops": ArrayFile(
        "A cable hung as a loop between two exits (`wrod bench hands`, CABLE-hanging.npz).",
        "a measurement of a hanging cable",
        {
            "shape": _place("K?", "N", 2, about="x right, z up"),
            "arc_length": Field(("N",), "m", order="rising"),
            "length": _LENGTH,
            "mass_per_length": Field((), "kg/m", above=0.0, high=1e3),
            "gravity": _GRAVITY,
        },
        least={"N": 3},
        axes={"K": "mounting", "N": "point"},
    ),
    "HeldCable": ArrayFile(
        "A cable clamped in a hand at several angles (`wrod bench hands`, SET-static.npz).",
        "a measurement of a cable held at its base",
        {"base_angle": _ANGLE, "mid": _place("K", 2), "end": _place("K", 2), **_CABLE},
        least={"K": 1},
        axes={"K": "angle"},
    ),
    "HeldSwing": ArrayFile(
        "A cable swinging from a hand (`wrod bench hands`, SET-swing.npz).",
        "a measurement of a cable that swings from a hand",
        {
            "time": Field(("K",), "s", order="rising"),
            "base_angle": _ANGLE,
            "mid_fitted": _place("K", 2),
            "end_fitted": _place("K", 2),
            "curvature_fit": Field(("K", 2), "", -1e3, 1e3),
            **_CABLE,
        },
        least={"K": 3},
        axes={"K": "frame"},
    ),
    "HeldPoses": ArrayFile(
        "Cables between a fixed end and an arm (`wrod bench hands`, poses-3d.npz).",
        "a measurement of cables between a fixed end and an arm",
        {
            "shape": _place("C", "P", "N", 3),
            "arc_length": Field(("N",), "m", order="rising"),
            "length": _LENGTH,
            "mass_per_length": Field(("C",), "kg/m", above=0.0, high=1e3),
            "gripper_shift": _place("P", 3),
            "gripper_axis_angle_deg": Field(("P", 3), "degrees", -3600.0, 3600.0),
            "end_turn_deg": Field(("P",), "degrees", -3600.0, 3600.0),
            "cables": Field(("C",), kind="text"),
        },
        least={"N": 3},
        axes={"C": "cable", "P": "pose", "N": "point"},
    ),
    "Photograph": ArrayFile(
        "A photographed rod (`wrod bench photographs`, ROD-PATTERN-METHOD.npz).",
        "a photograph's file",
        {
            "centerline_filled": _place("N", 2),
            "hidden": Field(("N",), about="0 where the rod is seen"),
            "sigma": Field(("N",), "m", gaps=True, about="positive where the rod is seen"),
            "pattern": _place("Q", "2 or 3"),
            "size_factor": Field(above=0.0, high=1e3),
            "px_from_pattern": Field((2, 3), "px/m and px"),
            "pixels": Field(("N", 2), "px", gaps=True),
            "registration_rms_px": _optional(unit="px", gaps=True),
            "px_per_m": _optional(unit="px/m", gaps=True),
        },
        least={"N": 3, "Q": 3},
        axes={"N": "point", "Q": "point of the pattern"},
    ),
    "Scan": ArrayFile(
        "A laid rod that `wrod scan` traced with a scale (`wrod laid`, `wrod measure`).",
        "a scan with a scale and a single rod in view",
        {"path_m": Field(("N", "2 or 3"), "m")},
        least={"N": 3},
        axes={"N": "point"},
    ),
    "LaidRod": ArrayFile(
        "The part of a deployment that `wrod laid` reads.",
        "the .npz of a deployment that `wrod deploy` wrote",
        {
            "centerline": Field(("N", "2 or 3"), "m", about="the grip holding (`--holding`)"),
            "released_centerline": _optional("N", "2 or 3", unit="m", about="the grip gone"),
        },
        least={"N": 3},
        axes={"N": "point"},
    ),
    "Points": ArrayFile(
        "Points of a pattern, or a laid rod; an .npy file, or a text file of rows, holds the "
        "points alone.",
        "a NumPy file of points",
        {
            "points": Field(("N", "2 or 3"), "m, or the unit that `units` names"),
            "units": Field(kind="text", needed=False),
        },
        axes={"N": "point"},
    ),
    "OptimisedPlan": ArrayFile(
        "An optimised plan, dimensionless (`wrod distil`, plans/plan-NUMBER.npz).",
        "an optimised plan; delete the file",
        {
            "laid": Field(("T",), "L_gb", order="rising"),
            "curvature": Field(("T",), "1/L_gb"),
            "basis": Field(("T", "P"), about="splines over the laid length"),
            "anchors": Field(
                ("A", "P", 3), "L_gb", about="their coefficients: none, optimised, networks'"
            ),
            "bowls": Field(("A", "B"), about="value, slope, matrix's upper triangle of the error"),
            "figures": Field((3,), about="length, k_s, friction"),
        },
        least={"T": 2, "A": 2, "P": 1},
        axes={"T": "contact node", "A": "corrections"},
    ),
    "Prediction": ArrayFile(
        "What `wrod bench photographs` predicts of an optimal photograph.",
        "a prediction of `wrod bench photographs`; delete the file",
        {"as_seen": _place("N", 2)},
        least={"N": 2},
        axes={"N": "point"},
    ),
    "ShardColumns": ArrayFile(
        "A shard of a dataset, dimensionless; the manifest says which columns there are.",
        "a shard of a dataset; delete the file",
        {
            "inputs": Field(("N", 3), about="l_s [L_gb], kappa [1/L_gb], k_s"),
            "position": Field(("N", 3), "L_gb", gaps=True, about="of the grip, from the contact"),
            "rotation": Field(("N", 3), "rad", gaps=True, about="rotation vector of the grip"),
            "force": Field(
                ("N", 3), "k_b/L_gb^2", gaps=True, about="on the suspended rod, at the contact"
            ),
            "residual": Field(("N",), gaps=True),
            "converged": Field(("N",), kind="truths"),
            "stable": Field(("N",), kind="truths"),
            "twist": _optional("N", unit="rad", gaps=True),
            "position_sensitivity": _optional(
                "N", 3, 3, gaps=True, about="derivative of component i by input j"
            ),
            "rotation_sensitivity": _optional("N", 3, 3, gaps=True),
            "force_sensitivity": _optional("N", 3, 3, gaps=True),
        },
        axes={"N": "row"},
        suffix=".safetensors",
    ),
    "Controller": ArrayFile(
        "Weights of a controller, layer by layer.",
        "a controller that `wrod train` wrote",
        {
            **_NETWORK,
            "mean": Field(("O",)),
            "scale": Field(("O",), low=0.0),
            "input_mean": _optional("I"),
            "input_scale": Field(("I",), above=0.0, needed=False),
        },
        together=(("input_mean", "input_scale"),),
        suffix=".safetensors",
    ),
    "Corrector": ArrayFile(
        "Weights of a corrector of plans, layer by layer.",
        "a corrector that `wrod distil` wrote",
        {**_NETWORK, "scale": Field((3,), low=0.0)},
        suffix=".safetensors",
    ),
}
