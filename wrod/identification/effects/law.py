"""Moments that do not follow the curvature in proportion."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter, unknowns

# Where yielding is first looked for in motion [1/m]: below what cables bend by there.
_YIELDS = 4.0


class Softening(Effect):
    """A rod whose moment falls behind its curvature, as of a cable whose strands begin to slip."""

    name = "softening"
    title = "bending stiffness that falls with curvature, from B to r B"
    reference = (
        "M = B k (r + (1 - r) / (1 + (k / k_c)^2)), a smooth form of the stick-slip law of "
        "stranded cables (Papailiou 1997)"
    )
    kinds: tuple[str, ...] = ("clamped", "motion")
    parameters = (
        Parameter("log_critical_curvature", "", 3.0, lower=-5.0, upper=10.0, anywhere=True),
        Parameter("lost_stiffness", "", 1.0, lower=0.0, upper=1.0),
    )
    # What is lost counts against the stiffness; where fits start; what is left, and where half of
    # the rest is lost, are called so.
    sign, first, left, place = -1.0, (0.1, 0.7), "kept_stiffness", "critical_curvature"

    def starts(self, measurements):
        if measurements is None:
            # In motion there is one start: amid what cables bend by there and what they may lose. A
            # fit from its edge comes to it in a dozen steps, or never.
            return [np.array([np.log(10.0), 0.3])]
        return [np.array([np.log(k), change]) for k in (3.0, 30.0) for change in self.first]

    def secant(self, curvature: np.ndarray, values: np.ndarray) -> np.ndarray:
        """M / (B k) at (n,) curvatures [1/m]."""
        x = (curvature / np.exp(values[0])) ** 2
        return 1.0 + self.sign * values[1] * x / (1.0 + x)

    def apply(self, setup, values):
        # A rod has one law: of two, the last counts.
        own = np.array([np.exp(-2.0 * values[0]), 1.0 + self.sign * values[1]])
        setup.softening = 0.0 * setup.softening + own

    def describe(self, values, covariance, measurements):
        errors = np.sqrt(np.diag(covariance))
        critical = float(np.exp(values[0]))
        return {
            self.place: Estimate(critical, float(critical * errors[0]), "1/m"),
            self.left: Estimate(1.0 + self.sign * float(values[1]), float(errors[1]), ""),
        }


class Stiffening(Softening):
    """A rod whose moment runs ahead of its curvature, as of a chain of beads that touch."""

    name = "stiffening"
    title = "bending stiffness that grows with curvature, from B to r B"
    reference = "M = B k (r + (1 - r) / (1 + (k / k_c)^2)) with r > 1: softening's law, backwards"
    parameters = (
        Parameter("log_critical_curvature", "", 3.0, lower=-5.0, upper=10.0, anywhere=True),
        Parameter("gained_stiffness", "", 1.0, lower=0.0, upper=9.0),
    )
    sign, first, left = 1.0, (0.1, 1.0), "final_stiffness"


class Yielding(Softening):
    """A wire that yields, and stays bent: a law of `wrod.rods.law.Plastic`.

    Trials are of rods that were straight (of their natural shape) before: bent once, and further
    and further, on the way to their poses. What the trial before has left is `Memory`'s to find.
    """

    name = "yielding"
    title = "bending stiffness that falls from B to r B at a yield curvature"
    reference = (
        "M = B e up to k_y, B k_y + r B (e - k_y) beyond: linear kinematic hardening (Simo & "
        "Hughes 1998, ch. 1), bent for the first time"
    )
    alike = "an elastic law of the same moments, which unloading alone would tell"
    # Of two laws this one counts.
    stage = 2
    left, place = "hardening", "yield_curvature"

    def starts(self, measurements):
        if measurements is None:
            return [np.array([np.log(_YIELDS), 0.3])]
        # A yield curvature that no trial reaches leaves nothing to go by.
        bent = measurements.largest_curvature
        return [np.array([np.log(u * bent), lost]) for u in (0.2, 0.5) for lost in self.first]

    def secant(self, curvature, values):
        return 1.0 - values[1] * np.maximum(1.0 - np.exp(values[0]) / curvature, 0.0)

    def apply(self, setup, values):
        setup.softening = np.zeros_like(setup.softening)
        if hasattr(setup, "law"):  # of clamped rods
            setup.law = setup.law[:0]
        setup.yielding = np.array([values[1], np.exp(values[0])])


# Of these a rod has one.
LAWS = (Softening.name, Stiffening.name, Yielding.name)


class BendTwist(Effect):
    """A rod that twists as it is bent, as one does whose layers or strands are laid at an angle."""

    name = "bend_twist"
    title = "bending and twisting that are coupled"
    reference = (
        "energy per length sqrt(B C) g . e (tau - tau_0) of the excess curvatures e and the twist "
        "(Dias & Audoly 2014); stable at rest where |g| < 1"
    )
    parameters = unknowns("", 0.5, "coupling_1", "coupling_2", lower=-0.9, upper=0.9)

    def apply(self, setup, values):
        size = np.sqrt(setup.bending[0, 0] * setup.twisting[0])
        setup.coupling = setup.coupling + size * np.asarray(values)


class InternalDamping(Effect):
    """A material whose moments also depend on how fast it is bent and twisted."""

    name = "internal_damping"
    title = "strain-rate damping inside the rod (Kelvin-Voigt)"
    reference = (
        "M = B (k + eta dk/dt), bending and twisting alike; Bergou et al. 2010, Discrete Viscous "
        "Threads, Sec. 4"
    )
    kinds = ("motion",)
    adds = "viscous_time"
    parameters = (Parameter("viscous_time", "s", 0.1, lower=0.0),)


class Relaxation(Effect):
    """A material whose viscous moments fade while it stays bent, as soft plastics do."""

    name = "relaxation"
    title = "time in which viscous moments relax (Zener's solid)"
    reference = (
        "M = B k + m, m + theta dm/dt = B eta dk/dt: at frequencies over 1 / theta rather stiffer "
        "by eta / theta than damped"
    )
    kinds = ("motion",)
    adds = "relaxation_time"
    parameters = (Parameter("relaxation_time", "s", 0.05, lower=0.0),)
