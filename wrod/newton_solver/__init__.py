"""Discrete elastic rods in Newton scenes: `SolverDER`, thin over `wrod.solvers.dynamics`."""

from wrod.newton_solver.solver import SolverDER

__all__ = ["SolverDER"]
