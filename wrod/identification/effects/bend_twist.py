"""A rod that twists as it is bent, as one does whose layers or strands are laid at an angle."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class BendTwist(Effect):
    name = "bend_twist"
    title = "bending and twisting that are coupled"
    reference = (
        "energy per length sqrt(B C) g . e (tau - tau_0) of the excess curvatures e and the twist "
        "(Dias & Audoly 2014); stable at rest where |g| < 1"
    )
    parameters = (
        Parameter("coupling_1", "", 0.5, lower=-0.9, upper=0.9),
        Parameter("coupling_2", "", 0.5, lower=-0.9, upper=0.9),
    )

    def apply(self, setup, values):
        size = np.sqrt(setup.bending[0, 0] * setup.twisting[0])
        setup.coupling = setup.coupling + size * np.asarray(values)
