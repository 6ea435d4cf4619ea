"""Knots: plans, topology, and tying by laying and moves of hands."""
