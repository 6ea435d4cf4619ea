"""A rod that slipped in clamp A: more of it, or less, hangs free."""

from wrod.identification.effect import Effect, Parameter


class ClampSlip(Effect):
    name = "clamp_slip"
    title = "free length changed at clamp A"
    reference = "free length L + slip, markers moved along with the rod"
    parameters = (Parameter("slip", "m", 0.03),)
    stage = 0

    def apply(self, setup, values):
        setup.length = setup.length + values[0]
        setup.marker_arc_length = setup.marker_arc_length + values[0]
