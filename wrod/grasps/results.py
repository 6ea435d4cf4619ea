"""Results of grasps, and for which inputs there are any."""

from dataclasses import dataclass

import numpy as np

from wrod.arguments import Check, optional
from wrod.errors import GraspError
from wrod.records import brief, checked_fields

# Inputs that are solved; beyond them grasps do not exist, or have never been checked.
LIMITS = {
    "suspended_length": (0.2, 100.0),
    "curvature": (-5.0, 5.0),
    "stretch_ratio": (50.0, 1e7),
    "natural_curvature": (-1.0, 1.0),
}
SENSITIVITIES = ("position_sensitivity", "rotation_sensitivity", "force_sensitivity")


def rows(*shape: int | None) -> Check:
    """An array of NumPy, torch or Warp of rows of that shape; None stands for any length."""

    def check(value):
        own = getattr(value, "shape", None)
        try:
            same = len(own) == 1 + len(shape) and all(
                a in (None, b) for a, b in zip(shape, own[1:], strict=True)
            )
        except Exception:  # whatever an object does that is asked for its shape
            same = False
        # Tensors and arrays of Warp say their own kinds of numbers.
        kind = getattr(getattr(value, "dtype", None), "kind", "f")
        wanted = str((None, *shape)).replace("None", "n")
        good = same and kind in "fiub" and not isinstance(value, type)
        return None if good else f"must be an array of numbers of shape {wanted}"

    return check


def same_rows(grasps) -> None:
    """Refuse grasps whose arrays have not as many rows as each other."""
    arrays = {name: value for name, value in vars(grasps).items() if hasattr(value, "shape")}
    counts = {name: value.shape[0] for name, value in arrays.items() if len(value.shape)}
    for name, count in counts.items():
        if count != counts["position"]:
            raise GraspError(
                f"{type(grasps).__name__}: {name} has {count} rows and position has "
                f"{counts['position']}; give one for each grasp"
            )


_ONE, _THREE, _NINE = rows(), rows(3), rows(3, 3)


@checked_fields(
    GraspError,
    position=_THREE, rotation=_THREE, force=_THREE,
    **dict.fromkeys(
        ("converged", "stable", "iterations", "residual", "twist", "eigenvalue", "growth",
         "natural_share"),
        optional(_ONE),
    ),
    shape=optional(rows(None, 3)), arc_length=optional(rows(None)),
    **dict.fromkeys(("force_jacobian", *SENSITIVITIES), optional(_NINE)),
)  # fmt: skip
@brief
@dataclass(frozen=True, eq=False)
class Grasps:
    """Optimal grasps, one per input (float64 NumPy, or tensors or Warp arrays
    on the device as the inputs were; dimensionless). `solve_grasps` fills all but the sensitivities
    and what it is not asked for; what another source does not say is None.

    Attributes:
        position: (n, 3) grip position in the contact frame [L_gb].
        rotation: (n, 3) rotation vector of the rod's material frame at the grip: R x is the tangent
            there. A naturally straight rod has no twist between contact and grip [rad].
        force: (n, 3) force on the suspended rod at the contact [k_b/L_gb^2].
        converged: (n,) an admissible and stable equilibrium to the tolerance: z >= 0 everywhere,
            F_z >= 0. Only these are results.
        stable: (n,) the held grasp is stable (no negative eigenvalue of the constrained Hessian).
        eigenvalue: (n,) how far the held grasp is from instability: the smallest eigenvalue of that
            Hessian, the stiffness per length of its softest motion [k_b/L_gb^4]; or None.
        growth: (n,) rate at which small departures of what is laid grow with its length, negative
            where they die out (`wrod.grasps.growth`) [1/L_gb]; None for naturally straight rods,
            which lay themselves straight again.
        iterations: (n,) Newton iterations, all meshes together.
        residual: (n,) largest unbalanced force on the finest mesh [k_b/L_gb^2].
        force_jacobian: (n, 3, 3) derivative of `force` by the grip position: the contact clamped,
            the grip's tangent free, and the roll about it, which a rod with sides of its own keeps.
        shape: (n, node, 3) the rod from contact to grip on the finest mesh [L_gb], or None.
        arc_length: (n, node) unstretched arc length of its nodes [L_gb], or None.
        twist: (n,) angle by which the rod is twisted between contact and grip, which may be more
            than a turn [rad]; None for naturally straight rods, which are not twisted.
        position_sensitivity, rotation_sensitivity, force_sensitivity: (n, 3, 3) derivatives of
            component i by input j of (suspended_length, curvature, stretch_ratio), or None.
        natural_share: (n,) share of its natural curvature that the rod has in each grasp
            (`wrod.grasps.relaxed`), or None where it has all of it.
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    # Whoever solves grasps always has these, and is not to ask a type checker's leave.
    converged: np.ndarray = None  # type: ignore[assignment]
    stable: np.ndarray = None  # type: ignore[assignment]
    iterations: np.ndarray = None  # type: ignore[assignment]
    residual: np.ndarray = None  # type: ignore[assignment]
    force_jacobian: np.ndarray | None = None
    shape: np.ndarray | None = None
    arc_length: np.ndarray | None = None
    twist: np.ndarray | None = None
    eigenvalue: np.ndarray | None = None
    growth: np.ndarray | None = None
    position_sensitivity: np.ndarray | None = None
    rotation_sensitivity: np.ndarray | None = None
    force_sensitivity: np.ndarray | None = None
    natural_share: np.ndarray | None = None

    def __post_init__(self) -> None:
        same_rows(self)

    def __len__(self) -> int:
        return len(self.position)
