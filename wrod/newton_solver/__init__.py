"""Discrete elastic rods in Newton scenes: `SolverDER`, a thin adapter over `wrod.dynamics`."""

from wrod.newton_solver.solver import SolverDER

__all__ = ["SolverDER"]
